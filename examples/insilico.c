/* insilico: what registration is worth, measured where the truth is known.
 *
 *     insilico [MODEL] [OPTIONS]      insilico --help lists the options
 *
 * Deforms an organ (a closed surface or a volume mesh; without one, a made-up organ of a liver's size) in the computer,
 * shows the methods its surface or the part that a camera sees, with noise and outliers and in another pose, and tells
 * how far their answers are off. The organ is of fine tets of a stable neo-Hookean material;
 * what is registered is a coarse model of another mesh and material. Patterns:
 *     respiration       a patch of the upper surface is moved down, as by the diaphragm
 *     instrument        a tool presses a dent into the upper surface
 *     pneumoperitoneum  gas presses on all that faces up: a fifth of 13 mmHg, since what lies below yields, too
 *     gravity           the patient is turned to the side
 * The lowest fifth of the organ is held. Errors are in mm over all nodes of the fine organ, those of its surface and
 * ten inside (target registration errors); the distance is the mean one of the target's points from the registered
 * surface: where it is small and errors are not, the motion is one that the shape does not show. icp is the rigid start
 * of all others. The box plot has median, quartiles, and the 5th and 95th percentile of the errors of all nodes.
 *
 * A view is of what a camera far away sees, from above in front unless --from says otherwise; of it --seen leaves a
 * share of the whole surface, about the middle of the view, as through the hole of a laparoscope.
 *
 * --study FILE does every pattern for --seeds seeds of chance, a row of the file for each, and --shard I/N a share of
 * them, to be run on many machines: see examples/study. What is in the file already is not done again; a method that
 * fails there is told in its row. Exit status: 0, 2 wrong usage or a file that cannot be read or written, 3 no memory,
 * or a method that failed. */
#include "system.h"

#if defined(_OPENMP)
#define SB_USE_OPENMP
#endif
#define SB_IMPLEMENTATION
#define REG_IMPLEMENTATION
#include "register.h"

#include <stdarg.h>

#include "options.h"
#include "plot.h"
#include "registration.h"
#include "rows.h"
#include "shard.h"

enum { EXIT_USAGE = 2, EXIT_FAILED = 3, PATTERNS = 4, MARKERS = 10 };
#define REAL(x) ((sb_real)(x)) /* everything here is in double, the bodies in sb_real */

static const char *const pattern_names[PATTERNS] = {"respiration", "instrument", "pneumoperitoneum", "gravity"};

typedef struct settings {
    const char *patterns, *methods, *out, *study, *shard, *from;
    int partial, linear, plain, fix, coarse, fine, seed, seeds, help;
    double scale, amplitude, noise, outliers, angle, shift, seconds, seen;
} settings;

/* Errors of one method on one pattern: sorted, in mm. */
typedef struct score {
    int ran;
    double *volume; /* [fine nodes] */
    double mean, median, most, surface_mean, surface_most, distance, marker_mean, marker_most;
    double seconds_start, seconds_setup, seconds_run;
    const char *stop;
    double expected; /* mm, on the mean, of methods that tell */
    int flagged;     /* 1: it says that it should not be trusted beyond 5 mm; -1: it does not tell */
} score;

/* What lasts from the files to the picture. Zeros: nothing yet. */
typedef struct work {
    const settings *set;
    const char *path; /* of the organ, or NULL */
    sb_vec3 view;     /* to the camera, unit */
    int seed;         /* of the present target */
    int pattern_on[PATTERNS], method_on[METHOD_COUNT];
    sb_mesh organ, model;    /* fine and coarse */
    sb_mesh skin;            /* of the organ, at rest */
    sb_mesh outline;         /* the same surface with other vertices: what methods know of it, and no vertex of the
                              * target has a partner there */
    sb_boundary boundary;    /* of the organ */
    sb_real held_below;      /* m */
    int *fixed, fixed_count; /* of the model */
    int *held, held_count;   /* of the organ */
    sb_vec3 low, high;
    double size;               /* m */
    double mean_way, most_way; /* mm, that the pattern moves the nodes */
    int markers[MARKERS];
    /* of the present pattern */
    sb_body *body;
    sb_vec3 *truth; /* [organ nodes] in the target's pose */
    sb_mesh target;
    reg_cloud cloud;
    unsigned long long random;
    score scores[PATTERNS][METHOD_COUNT];
} work;

/* ---- messages -------------------------------------------------------------------------------------------------- */

static int complain(const char *about, const char *message)
{
    progress_end();
    fprintf(stderr, "insilico: %s: %s\n", about, message);
    return EXIT_USAGE;
}

static int complain_error(const char *about, const sb_error *error)
{
    int status;
    if (error->file[0] && error->line > 0) {
        progress_end();
        fprintf(stderr, "insilico: %s:%d: %s\n", error->file, error->line, error->message);
        return EXIT_USAGE;
    }
    status = complain(error->file[0] ? error->file : about, error->message);
    return error->result == SB_ERROR_MEMORY ? EXIT_FAILED : status;
}

static int complain_memory(void)
{
    progress_end();
    fputs("insilico: not enough memory\n", stderr);
    return EXIT_FAILED;
}

/* ---- chance ---------------------------------------------------------------------------------------------------- */

/* In [0, 1): the same everywhere (xorshift64*). */
static double chance(work *w)
{
    unsigned long long x = w->random;
    x ^= x >> 12;
    x ^= x << 25;
    x ^= x >> 27;
    w->random = x;
    return (double)((x * 2685821657736338717ULL) >> 11) / 9007199254740992.0;
}

/* Of a normal distribution (Box, Muller 1958). */
static double chance_normal(work *w)
{
    double u = 1 - chance(w), v = chance(w);
    return sqrt(-2 * log(u)) * cos(6.283185307179586 * v);
}

static sb_vec3 chance_vector(work *w)
{
    double x = chance_normal(w), y = chance_normal(w);
    return sb_v3(REAL(x), REAL(y), REAL(chance_normal(w)));
}

static sb_vec3 chance_direction(work *w)
{
    sb_vec3 v = chance_vector(w);
    sb_real length = sb_v3_norm(v);
    return length > 0 ? sb_v3_scale(1 / length, v) : sb_v3(0, 0, 1);
}

/* ---- the organ ------------------------------------------------------------------------------------------------- */

static double bump(sb_vec3 at, double x, double y, double z, double a, double b, double c)
{
    double u = ((double)at.x - x) / a, v = ((double)at.y - y) / b, t = ((double)at.z - z) / c;
    return sqrt(u * u + v * v + t * t) - 1;
}

/* Two lobes that run into each other, and a hollow below: about 1.4 litres. Negative inside; no distance. */
static sb_real made_up_organ(void *user, sb_vec3 at)
{
    double right = 0.06 * bump(at, 0.035, 0, 0, 0.085, 0.07, 0.048);
    double left = 0.04 * bump(at, -0.055, 0.012, 0.01, 0.075, 0.048, 0.026);
    double hollow = 0.04 * bump(at, 0.005, -0.02, -0.065, 0.05, 0.04, 0.04), k = 0.016, h, joined;
    (void)user;
    h = fmax(k - fabs(right - left), 0) / k;
    joined = fmin(right, left) - 0.25 * k * h * h;
    return REAL(fmax(joined, -hollow));
}

static int show_meshing(void *user, double share)
{
    progress_show(share, (const char *)user);
    return 0;
}

static sb_result fill(const sb_surface *surface, double cell, sb_mesh *mesh, sb_error *error)
{
    static char words[] = "filling the organ with tets";
    sb_stuff_def def = sb_default_stuff_def();
    sb_shape shape;
    memset(&shape, 0, sizeof shape);
    shape.surface = surface;
    shape.distance = surface ? NULL : made_up_organ;
    def.shapes = &shape;
    def.shape_count = 1;
    def.low = sb_v3(REAL(-0.15), REAL(-0.09), REAL(-0.07));
    def.high = sb_v3(REAL(0.14), REAL(0.09), REAL(0.07));
    def.cell = REAL(cell);
    def.progress = show_meshing;
    def.progress_user = words;
    return sb_mesh_stuff(&def, mesh, NULL, error);
}

static double longest(sb_vec3 low, sb_vec3 high)
{
    sb_vec3 size = sb_v3_sub(high, low);
    return fmax((double)size.x, fmax((double)size.y, (double)size.z));
}

/* The fine organ: the file's volume, its surface filled, or the made-up one. */
static int load_organ(work *w, const char *path)
{
    sb_load_options options = sb_default_load_options();
    sb_mesh loaded;
    sb_surface *tree = NULL;
    sb_error error;
    sb_result result;
    memset(&loaded, 0, sizeof loaded);
    if (!path)
        return fill(NULL, 0.25 / w->set->fine, &w->organ, &error) == SB_OK ? 0 : complain_error("the organ", &error);
    options.scale = REAL(w->set->scale);
    if (sb_mesh_load(&loaded, path, &options, &error) != SB_OK)
        return complain_error(path, &error);
    if (sb_element_dimension(loaded.element_type) == 3) {
        w->organ = loaded;
        return 0;
    }
    result = sb_surface_require(&loaded, SB_SURFACE_OPEN_EDGES | SB_SURFACE_INSIDE_OUT, NULL, NULL, &error);
    if (result == SB_OK)
        result = sb_surface_create(&loaded, NULL, &tree, &error);
    if (result == SB_OK) {
        sb_mesh_bounds(&loaded, &w->low, &w->high);
        result = fill(tree, longest(w->low, w->high) / w->set->fine, &w->organ, &error);
    }
    sb_surface_destroy(tree);
    sb_mesh_free(&loaded);
    return result == SB_OK ? 0 : complain_error(path, &error);
}

static int ascending_reals(const void *a, const void *b)
{
    sb_real x = *(const sb_real *)a, y = *(const sb_real *)b;
    return (x > y) - (x < y);
}

/* The height that a fifth of the organ is below: so much of any shape is held that the rest does not swing from a
 * tip. */
static int find_held_height(work *w)
{
    int n = w->organ.node_count;
    sb_real *heights = (sb_real *)malloc((size_t)n * sizeof *heights);
    if (!heights)
        return complain_memory();
    for (int i = 0; i < n; i++)
        heights[i] = w->organ.nodes[i].z;
    qsort(heights, (size_t)n, sizeof *heights, ascending_reals);
    w->held_below = heights[n / 5];
    free(heights);
    return 0;
}

static int is_held(const work *w, sb_vec3 at) { return at.z < w->held_below; }

static int *held_nodes(const work *w, const sb_mesh *mesh, int *count)
{
    int *nodes = (int *)malloc((size_t)mesh->node_count * sizeof *nodes);
    *count = 0;
    for (int i = 0; nodes && i < mesh->node_count; i++)
        if (is_held(w, mesh->nodes[i]))
            nodes[(*count)++] = i;
    return nodes;
}

/* Markers: points inside, evenly spread. */
static int place_markers(work *w)
{
    size_t n = (size_t)w->organ.node_count;
    sb_vec3 *inside = (sb_vec3 *)malloc(n * sizeof *inside);
    int *numbers = (int *)malloc(n * sizeof *numbers), chosen[MARKERS], count = 0, kept = 0;
    unsigned char *outer = (unsigned char *)calloc(n, 1);
    sb_real *scratch = (sb_real *)malloc(n * sizeof *scratch);
    if (inside && numbers && outer && scratch) {
        for (int i = 0; i < w->boundary.surface.node_count; i++)
            outer[w->boundary.nodes[i]] = 1;
        for (int i = 0; i < w->organ.node_count; i++)
            if (!outer[i]) {
                numbers[count] = i;
                inside[count++] = w->organ.nodes[i];
            }
        kept = count ? reg_cloud_spread(inside, count, MARKERS < count ? MARKERS : count, chosen, scratch) : 0;
        for (int i = 0; i < MARKERS; i++)
            w->markers[i] = kept ? numbers[chosen[i % kept]] : 0;
    }
    free(inside);
    free(numbers);
    free(outer);
    free(scratch);
    return kept ? 0 : complain("the organ", "has no nodes inside: take a larger --fine");
}

static sb_result make_outline(work *w, const sb_surface *tree, sb_error *error)
{
    sb_mesh other;
    sb_boundary boundary;
    sb_result result = fill(tree, 1.17 * longest(w->low, w->high) / w->set->fine, &other, error);
    if (result != SB_OK)
        return result;
    result = sb_mesh_boundary(&other, 1, NULL, &boundary, error);
    if (result == SB_OK) {
        result = sb_mesh_copy(&boundary.surface, NULL, &w->outline, error);
        sb_boundary_free(&boundary);
    }
    sb_mesh_free(&other);
    return result;
}

static int make_organ(work *w, const char *path)
{
    sb_surface *tree = NULL;
    sb_error error;
    sb_result result;
    int status = load_organ(w, path);
    if (status)
        return status;
    result = sb_mesh_boundary(&w->organ, 1, NULL, &w->boundary, &error);
    if (result == SB_OK)
        result = sb_surface_triangulate(&w->boundary.surface, NULL, &w->skin, &error);
    if (result == SB_OK)
        result = sb_surface_create(&w->skin, NULL, &tree, &error);
    sb_mesh_bounds(&w->organ, &w->low, &w->high);
    w->size = (double)sb_v3_norm(sb_v3_sub(w->high, w->low));
    if (result == SB_OK)
        result = fill(tree, longest(w->low, w->high) / w->set->coarse, &w->model, &error);
    if (result == SB_OK)
        result = make_outline(w, tree, &error);
    sb_surface_destroy(tree);
    progress_end();
    if (result != SB_OK)
        return complain_error("the organ", &error);
    if (find_held_height(w))
        return EXIT_FAILED;
    w->held = held_nodes(w, &w->organ, &w->held_count);
    w->fixed = held_nodes(w, &w->model, &w->fixed_count);
    w->truth = (sb_vec3 *)malloc((size_t)w->organ.node_count * sizeof *w->truth);
    if (!w->held || !w->fixed || !w->truth)
        return complain_memory();
    return place_markers(w);
}

/* ---- patterns -------------------------------------------------------------------------------------------------- */

/* Node of the surface that is highest above a place of the plan, given in shares of the bounding box. */
static int top_node(const work *w, double share_x, double share_y)
{
    double x = (double)w->low.x + share_x * (double)(w->high.x - w->low.x);
    double y = (double)w->low.y + share_y * (double)(w->high.y - w->low.y), best = -HUGE_VAL;
    int node = 0;
    for (int i = 0; i < w->boundary.surface.node_count; i++) {
        sb_vec3 at = w->boundary.surface.nodes[i];
        double aside = hypot((double)at.x - x, (double)at.y - y), worth = (double)at.z - 3 * aside;
        if (worth > best) {
            best = worth;
            node = w->boundary.nodes[i];
        }
    }
    return node;
}

/* Moves the surface about a node with a Gaussian profile of that width, cut off where it has fallen to an eighth. */
static sb_result push_patch(work *w, int node, double width, sb_vec3 way)
{
    sb_vec3 middle = w->organ.nodes[node];
    sb_result result = SB_OK;
    for (int i = 0; result == SB_OK && i < w->boundary.surface.node_count; i++) {
        int n = w->boundary.nodes[i];
        double r = (double)sb_v3_norm(sb_v3_sub(w->organ.nodes[n], middle)) / width, profile = exp(-0.5 * r * r);
        sb_vec3 u = sb_v3_scale(REAL(profile), way);
        if (profile > 0.125 && !is_held(w, w->organ.nodes[n]))
            result = sb_body_prescribe(w->body, &n, 1, SB_XYZ, &u, 1);
    }
    return result;
}

/* Pressure on faces that look up and are not held, as a load that keeps its direction. */
static sb_result press_gas(work *w, double pressure, sb_error *error)
{
    const sb_mesh *surface = &w->boundary.surface;
    int corners = sb_element_corner_count(surface->element_type), width = sb_mesh_element_width(surface);
    sb_result result = SB_OK;
    for (int f = 0; result == SB_OK && f < surface->element_count; f++) {
        const int *c = surface->elements + f * width;
        const sb_vec3 *x = surface->nodes;
        sb_vec3 n = sb_v3_cross(sb_v3_sub(x[c[1]], x[c[0]]), sb_v3_sub(x[c[2]], x[c[0]]));
        int face[4];
        if (!(n.z > 0) || is_held(w, x[c[0]]))
            continue;
        for (int k = 0; k < corners; k++)
            face[k] = w->boundary.nodes[c[k]];
        n = sb_v3_scale(REAL(-pressure) / sb_v3_norm(n), n);
        result = sb_body_add_traction(w->body, face, 1, corners, n, error);
    }
    return result;
}

static sb_result apply_pattern(work *w, int pattern, sb_error *error)
{
    double depth = w->set->amplitude * w->size;
    sb_result result = SB_OK;
    if (pattern == 0)
        result = push_patch(w, top_node(w, 0.6, 0.5), 0.18 * w->size, sb_v3(REAL(0.2 * depth), 0, REAL(-0.98 * depth)));
    else if (pattern == 1)
        result = push_patch(w, top_node(w, 0.4, 0.45), 0.06 * w->size, sb_v3(0, 0, REAL(-0.6 * depth)));
    else if (pattern == 2)
        return press_gas(w, 350, error);
    else
        result = sb_body_set_gravity(w->body, sb_v3(REAL(-8.5), 0, REAL(-4.9)));
    return result == SB_OK ? SB_OK : task_fail(error, result, "the pattern could not be applied");
}

static void show_deforming(void *user, const sb_step_info *info)
{
    progress_show((double)info->load_factor, (const char *)user);
}

/* Pushes, presses or drops the organ: its displacement to w->truth. */
static int deform(work *w, int pattern)
{
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    sb_error error;
    sb_result result;
    char words[64];
    snprintf(words, sizeof words, "%s", pattern_names[pattern]);
    def.mesh = &w->organ;
    def.material = sb_material_stable_neo_hookean(15000, REAL(0.45), 1060);
    if (sb_body_create(&def, &w->body, &error) != SB_OK)
        return complain_error("the organ", &error);
    result = sb_body_fix_nodes(w->body, w->held, w->held_count, SB_XYZ) == SB_OK
                 ? apply_pattern(w, pattern, &error)
                 : task_fail(&error, SB_ERROR_MEMORY, "not enough memory");
    if (result != SB_OK)
        return complain_error("the organ", &error);
    options.load_steps = 5;
    options.tolerance = REAL(1e-4); /* errors are looked at in micrometres at best */
    options.progress = show_deforming;
    options.progress_user = words;
    result = sb_body_solve_static(w->body, &options, &info);
    progress_end();
    if (result != SB_OK) {
        complain(pattern_names[pattern], info.error.message);
        return EXIT_FAILED;
    }
    memcpy(w->truth, sb_body_positions(w->body), (size_t)w->organ.node_count * sizeof *w->truth);
    w->mean_way = w->most_way = 0;
    for (int i = 0; i < w->organ.node_count; i++) {
        double u = 1e3 * (double)sb_v3_norm(sb_body_displacements(w->body)[i]);
        w->mean_way += u / w->organ.node_count;
        w->most_way = fmax(w->most_way, u);
    }
    sb_body_destroy(w->body);
    w->body = NULL;
    return 0;
}

/* ---- what is seen of it ---------------------------------------------------------------------------------------- */

static double facet_area(const sb_mesh *mesh, int triangle, sb_vec3 *middle)
{
    const int *c = mesh->elements + 3 * triangle;
    sb_vec3 a = mesh->nodes[c[0]], b = mesh->nodes[c[1]], d = mesh->nodes[c[2]];
    *middle = sb_v3_scale(REAL(1.0 / 3), sb_v3_add(a, sb_v3_add(b, d)));
    return 0.5 * (double)sb_v3_norm(sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(d, a)));
}

/* Leaves the triangles that a camera far away sees. */
static sb_result cut_visible(work *w, sb_vec3 view, sb_error *error)
{
    sb_mesh *mesh = &w->target;
    sb_surface *tree = NULL;
    int kept = 0;
    sb_result result = sb_surface_create(mesh, NULL, &tree, error);
    if (result != SB_OK)
        return result;
    for (int t = 0; t < mesh->element_count; t++) {
        const int *c = mesh->elements + 3 * t;
        sb_vec3 a = mesh->nodes[c[0]], b = mesh->nodes[c[1]], d = mesh->nodes[c[2]];
        sb_vec3 normal = sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(d, a));
        sb_vec3 middle = sb_v3_scale(REAL(1.0 / 3), sb_v3_add(a, sb_v3_add(b, d)));
        if (!(sb_v3_dot(normal, view) > REAL(0.15) * sb_v3_norm(normal)) ||
            sb_surface_ray(tree, sb_v3_madd(middle, REAL(1e-3 * w->size), view), view, SB_REAL_MAX, NULL))
            continue;
        memmove(mesh->elements + 3 * kept++, c, 3 * sizeof *c);
    }
    sb_surface_destroy(tree);
    mesh->element_count = kept;
    return kept ? sb_mesh_remove_unreferenced(mesh, NULL, error)
                : task_fail(error, SB_ERROR_MESH, "nothing of the organ is visible");
}

typedef struct seen_facet {
    double aside, area; /* of the middle from the axis of the view (m); m^2 */
    int triangle;
} seen_facet;

static int compare_facets(const void *a, const void *b)
{
    const seen_facet *f = (const seen_facet *)a, *g = (const seen_facet *)b;
    return f->aside != g->aside ? (f->aside < g->aside ? -1 : 1) : f->triangle - g->triangle;
}

/* Puts the triangles of a mesh about the middle of the view that make up `area` (m^2) first. Returns how many. Scratch:
 * facets, triangles of all. */
static int keep_middle(sb_mesh *mesh, sb_vec3 view, double area, seen_facet *facets, int *triangles)
{
    sb_vec3 centre = sb_v3(0, 0, 0), middle;
    int count = mesh->element_count, kept = 0;
    double all = 0;
    for (int t = 0; t < count; t++) {
        facets[t].triangle = t;
        facets[t].area = facet_area(mesh, t, &middle);
        centre = sb_v3_madd(centre, REAL(facets[t].area), middle);
        all += facets[t].area;
    }
    centre = sb_v3_scale(REAL(1 / all), centre);
    for (int t = 0; t < count; t++) {
        sb_vec3 off;
        facet_area(mesh, t, &middle);
        off = sb_v3_sub(middle, centre);
        facets[t].aside = (double)sb_v3_norm(sb_v3_madd(off, -sb_v3_dot(off, view), view));
    }
    qsort(facets, (size_t)count, sizeof *facets, compare_facets);
    memcpy(triangles, mesh->elements, 3 * (size_t)count * sizeof *triangles);
    for (double sum = 0; kept < count && sum < area; kept++) {
        sum += facets[kept].area;
        memcpy(mesh->elements + 3 * kept, triangles + 3 * facets[kept].triangle, 3 * sizeof *triangles);
    }
    return kept;
}

/* Of what is seen, leaves so much of the organ's surface (m^2) about the middle of the view. */
static sb_result cut_share(work *w, sb_vec3 view, double area, sb_error *error)
{
    sb_mesh *mesh = &w->target;
    size_t count = (size_t)mesh->element_count;
    seen_facet *facets = (seen_facet *)malloc(count * sizeof *facets);
    int *triangles = (int *)malloc(3 * count * sizeof *triangles);
    sb_result result = SB_OK;
    if (facets && triangles)
        mesh->element_count = keep_middle(mesh, view, area, facets, triangles);
    else
        result = task_fail(error, SB_ERROR_MEMORY, "not enough memory");
    free(facets);
    free(triangles);
    return result == SB_OK ? sb_mesh_remove_unreferenced(mesh, NULL, error) : result;
}

/* What the camera sees of the target. */
static sb_result cut_view(work *w, sb_error *error)
{
    const sb_mesh *mesh = &w->target;
    sb_vec3 middle;
    double area = 0;
    sb_result result;
    for (int t = 0; t < mesh->element_count; t++)
        area += facet_area(mesh, t, &middle);
    result = cut_visible(w, w->view, error);
    if (result == SB_OK && w->set->seen > 0)
        result = cut_share(w, w->view, 0.01 * w->set->seen * area, error);
    return result;
}

/* Another pose, for the target and the truth. */
static void move_all(work *w)
{
    reg_rigid motion = reg_rigid_identity();
    sb_vec3 axis = chance_direction(w), way = chance_direction(w);
    sb_vec3 middle = sb_v3_scale(REAL(0.5), sb_v3_add(w->low, w->high));
    axis = sb_v3_scale(REAL(w->set->angle / 57.29577951), axis);
    motion.rotation = sb_quat_to_mat3(sb_quat_from_rotation_vector(axis));
    motion.translation = sb_v3_sub(middle, sb_m3_apply(motion.rotation, middle));
    motion.translation = sb_v3_madd(motion.translation, REAL(1e-3 * w->set->shift), way);
    for (int i = 0; i < w->organ.node_count; i++)
        w->truth[i] = reg_rigid_apply(&motion, w->truth[i]);
    for (int i = 0; i < w->target.node_count; i++)
        w->target.nodes[i] = reg_rigid_apply(&motion, w->target.nodes[i]);
}

/* The target as a cloud with points of something else, cleaned and with normals, as a scan would be. */
static sb_result spoil(work *w, sb_error *error)
{
    int count = w->target.node_count, wrong = (int)(0.01 * w->set->outliers * count);
    sb_vec3 *points = (sb_vec3 *)malloc((size_t)(count + wrong) * sizeof *points), low, high, size;
    sb_result result;
    if (!points)
        return task_fail(error, SB_ERROR_MEMORY, "not enough memory");
    memcpy(points, w->target.nodes, (size_t)count * sizeof *points);
    sb_mesh_bounds(&w->target, &low, &high);
    size = sb_v3_sub(high, low);
    for (int i = 0; i < wrong; i++) {
        double x = chance(w), y = chance(w), z = chance(w);
        points[count + i] = sb_v3_add(low, sb_v3(REAL(x) * size.x, REAL(y) * size.y, REAL(z) * size.z));
    }
    result = reg_cloud_from_points(&w->cloud, points, NULL, count + wrong, NULL, error);
    free(points);
    if (result == SB_OK)
        result = reg_cloud_remove_outliers(&w->cloud, 8, REG_OUTLIERS_MEDIAN, 3, NULL, error);
    if (result == SB_OK)
        result = reg_cloud_estimate_normals(&w->cloud, 12, NULL, NULL, error);
    return result;
}

static int observe(work *w)
{
    sb_error error;
    sb_result result = sb_mesh_copy(&w->skin, NULL, &w->target, &error);
    if (result == SB_OK)
        for (int i = 0; i < w->target.node_count; i++)
            w->target.nodes[i] = w->truth[w->boundary.nodes[i]];
    if (result == SB_OK && w->set->partial)
        result = cut_view(w, &error);
    if (result != SB_OK)
        return complain_error("the target", &error);
    move_all(w);
    for (int i = 0; w->set->noise > 0 && i < w->target.node_count; i++)
        w->target.nodes[i] = sb_v3_madd(w->target.nodes[i], REAL(1e-3 * w->set->noise), chance_vector(w));
    if (w->set->outliers > 0 && spoil(w, &error) != SB_OK)
        return complain_error("the target", &error);
    return 0;
}

/* ---- scores ---------------------------------------------------------------------------------------------------- */

static int compare_numbers(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

static double percentile(const double *sorted, int count, double share)
{
    return sorted[(int)(share * (count - 1) + 0.5)];
}

static void score_points(const work *w, const sb_vec3 *moved, score *s)
{
    const sb_mesh *surface = &w->boundary.surface;
    int n = w->organ.node_count;
    for (int i = 0; i < n; i++) {
        s->volume[i] = 1e3 * (double)sb_v3_norm(sb_v3_sub(moved[i], w->truth[i]));
        s->mean += s->volume[i] / n;
    }
    for (int i = 0; i < surface->node_count; i++) {
        double e = s->volume[w->boundary.nodes[i]];
        s->surface_mean += e / surface->node_count;
        s->surface_most = fmax(s->surface_most, e);
    }
    for (int i = 0; i < MARKERS; i++) {
        double e = s->volume[w->markers[i]];
        s->marker_mean += e / (double)MARKERS;
        s->marker_most = fmax(s->marker_most, e);
    }
    qsort(s->volume, (size_t)n, sizeof *s->volume, compare_numbers);
    s->median = percentile(s->volume, n, 0.5);
    s->most = s->volume[n - 1];
}

/* What the method says of its own error, and whether it should be trusted to 5 mm. */
static void score_trust(const outcome *out, score *s)
{
    const double limit = 5; /* mm that may be expected */
    const double least_seen = 0.15;
    reg_quality quality;
    s->flagged = -1;
    if (!out->infer || reg_infer_get_quality(out->infer, &quality) != SB_OK)
        return;
    s->expected = 1e3 * (double)quality.expected;
    s->flagged = (out->rigid.warnings & (REG_WARN_AMBIGUOUS | REG_WARN_SCALE)) != 0 || s->expected > limit ||
                 (double)quality.seen < least_seen || strcmp(out->stop, "no_overlap") == 0;
}

static sb_result score_outcome(const work *w, const outcome *out, const task *given, score *s, sb_error *error)
{
    size_t n = (size_t)w->organ.node_count;
    sb_vec3 *moved = (sb_vec3 *)malloc(n * sizeof *moved);
    double median;
    sb_result result;
    free(s->volume);
    memset(s, 0, sizeof *s);
    s->volume = (double *)malloc(n * sizeof *s->volume);
    result = moved && s->volume ? outcome_carry(out, w->organ.nodes, w->organ.node_count, moved, error)
                                : task_fail(error, SB_ERROR_MEMORY, "not enough memory");
    if (result == SB_OK)
        result = outcome_distance(out, given, &s->distance, &median, error);
    if (result == SB_OK) {
        score_points(w, moved, s);
        s->distance *= 1e3;
        s->seconds_start = out->seconds_start;
        s->seconds_setup = out->seconds_setup;
        s->seconds_run = out->seconds_run;
        s->stop = out->stop;
        s->ran = 1;
        score_trust(out, s);
    }
    free(moved);
    return result;
}

/* Motions are told without the pose. */
static void print_heading(const work *w, int pattern)
{
    printf("\n%s: deformed by %.2f mm on average, %.2f at most; target: %d points%s\n", pattern_names[pattern],
           w->mean_way, w->most_way, w->set->outliers > 0 ? w->cloud.count : w->target.node_count,
           w->set->partial ? ", the visible part" : "");
    printf("  %-13s %23s | %15s %8s | %15s | %20s\n", "", "errors of all nodes, mm", "of the surface", "target",
           "of ten inside", "times, s");
    printf("  %-13s %7s %7s %7s | %7s %7s %8s | %7s %7s | %6s %6s %6s  %s\n", "method", "mean", "median", "max", "mean",
           "max", "distance", "mean", "max", "start", "set-up", "run", "stop");
}

static void print_score(const char *name, const score *s)
{
    printf("  %-13s %7.3f %7.3f %7.2f | %7.3f %7.2f %8.3f | %7.3f %7.2f | %6.3f %6.3f %6.3f  %s\n", name, s->mean,
           s->median, s->most, s->surface_mean, s->surface_most, s->distance, s->marker_mean, s->marker_most,
           s->seconds_start, s->seconds_setup, s->seconds_run, s->stop);
    if (s->flagged >= 0)
        printf("  %-13s %7.3f expected%s\n", "", s->expected, s->flagged ? ", not to be trusted" : "");
}

/* Rows of a study must not depend on the machine: there it takes as long as it takes. */
static double most_seconds(const settings *set)
{
    if (set->seconds > 0)
        return set->seconds;
    return set->study ? 1e9 : 30;
}

static int run_method(work *w, int pattern, method how)
{
    task given;
    outcome out;
    sb_error error;
    sb_result result;
    memset(&given, 0, sizeof given);
    given.model = &w->model;
    given.surface = &w->outline;
    given.target = w->set->outliers > 0 ? NULL : &w->target;
    given.cloud = w->set->outliers > 0 ? &w->cloud : NULL;
    given.partial = w->set->partial;
    given.any = 1;
    given.linear = w->set->linear;
    given.noisy = w->set->noise > 0;
    given.loads = !w->set->plain && !w->set->linear;
    given.fixed = w->fixed;
    given.fixed_count = w->set->fix ? w->fixed_count : 0;
    given.young = 5000;
    given.poisson = 0.45;
    given.steps = 300;
    given.max_seconds = most_seconds(w->set);
    given.progress = progress_show;
    result = task_run(&given, how, &out, &error);
    if (result == SB_OK)
        result = score_outcome(w, &out, &given, &w->scores[pattern][how], &error);
    outcome_free(&out);
    progress_end();
    if (result != SB_OK) {
        complain_error(method_names[how], &error);
        return EXIT_FAILED;
    }
    print_score(method_names[how], &w->scores[pattern][how]);
    return 0;
}

/* A method that fails is told and left out; the others go on. */
static int run_pattern(work *w, int pattern)
{
    int status = deform(w, pattern), failed = 0;
    w->random = 0x9e3779b97f4a7c15ULL * (unsigned long long)(w->seed + 1) + (unsigned long long)pattern;
    if (!status)
        status = observe(w);
    if (!status)
        print_heading(w, pattern);
    for (int m = 0; !status && m < METHOD_COUNT; m++)
        if (w->method_on[m] && run_method(w, pattern, (method)m))
            failed = EXIT_FAILED;
    sb_mesh_free(&w->target);
    reg_cloud_free(&w->cloud);
    return status ? status : failed;
}

/* ---- the picture ----------------------------------------------------------------------------------------------- */

enum { BOX_POINTS = 24 };

/* Strokes of the boxes of one method. */
typedef struct boxes {
    double x[PATTERNS * BOX_POINTS], y[PATTERNS * BOX_POINTS];
    int count;
} boxes;

static void add_stroke(boxes *b, double x0, double y0, double x1, double y1)
{
    b->x[b->count] = x0;
    b->y[b->count++] = y0;
    b->x[b->count] = x1;
    b->y[b->count++] = y1;
    b->x[b->count] = b->y[b->count] = (double)NAN; /* lifts the pen */
    b->count++;
}

static void add_box(boxes *b, double x, double half, const double *sorted, int count)
{
    double p[5];
    const double shares[5] = {0.05, 0.25, 0.5, 0.75, 0.95};
    for (int i = 0; i < 5; i++)
        p[i] = percentile(sorted, count, shares[i]);
    add_stroke(b, x - half, p[1], x + half, p[1]);
    add_stroke(b, x - half, p[2], x + half, p[2]);
    add_stroke(b, x - half, p[3], x + half, p[3]);
    add_stroke(b, x - half, p[1], x - half, p[3]);
    add_stroke(b, x + half, p[1], x + half, p[3]);
    add_stroke(b, x, p[0], x, p[1]);
    add_stroke(b, x, p[3], x, p[4]);
}

static int write_picture(const work *w)
{
    static boxes drawn[METHOD_COUNT];
    const char *names[PATTERNS];
    plot chart;
    plot_panel *panel;
    int shown = 0, slot = 0, at = 0;
    for (int m = 0; m < METHOD_COUNT; m++)
        shown += w->method_on[m];
    plot_begin(&chart, "Registration against the truth");
    for (int p = 0; p < PATTERNS; p++)
        if (w->pattern_on[p])
            names[at++] = pattern_names[p];
    panel = plot_add_panel(&chart, "error of all nodes: median, quartiles, 5 and 95 %", "", "error (mm)");
    panel->x_names = names;
    panel->x_name_count = at;
    for (int m = 0; m < METHOD_COUNT; m++) {
        at = 0;
        drawn[m].count = 0;
        for (int p = 0; w->method_on[m] && p < PATTERNS; p++) {
            double x = ++at + 0.8 * ((slot + 0.5) / shown - 0.5);
            at -= !w->pattern_on[p];
            if (w->pattern_on[p] && w->scores[p][m].ran)
                add_box(&drawn[m], x, 0.3 / shown, w->scores[p][m].volume, w->organ.node_count);
        }
        slot += w->method_on[m];
        if (w->method_on[m])
            plot_add_curve(panel, method_names[m], drawn[m].x, drawn[m].y, drawn[m].count);
    }
    if (!plot_save_svg(&chart, w->set->out))
        return complain(w->set->out, "could not be written");
    printf("\n%s written\n", w->set->out);
    return 0;
}

/* ---- a study --------------------------------------------------------------------------------------------------- */

enum { STUDY_TEXT = 4096 };

/* Appends to text[STUDY_TEXT]. */
static void append(char *text, const char *format, ...)
{
    size_t used = strlen(text);
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text + used, STUDY_TEXT - used, format, arguments);
    va_end(arguments);
}

static int patterns_on(const work *w)
{
    int count = 0;
    for (int p = 0; p < PATTERNS; p++)
        count += w->pattern_on[p];
    return count;
}

/* All that rows depend on, so that no others are mixed with them, and the names of the columns. */
static void write_heading(const work *w, int cases, char *text)
{
    const settings *set = w->set;
    text[0] = 0;
    append(text,
           "# insilico %s cases=%d seed=%d patterns=%s methods=%s coarse=%d fine=%d scale=%g amplitude=%g noise=%g "
           "outliers=%g angle=%g shift=%g seconds=%g%s%s%s%s\n",
           w->path ? w->path : "(made up)", cases, set->seed, set->patterns, set->methods, set->coarse, set->fine,
           set->scale, set->amplitude, set->noise, set->outliers, set->angle, set->shift, set->seconds,
           set->partial ? " partial" : "", set->linear ? " linear" : "", set->plain ? " plain" : "",
           set->fix ? " fix" : "");
    if (set->from || set->seen > 0) { /* before the end of the line */
        text[strlen(text) - 1] = 0;
        append(text, " from=%s seen=%g\n", set->from ? set->from : "above", set->seen);
    }
    append(text, "case,seed,pattern,moved_mean_mm,moved_most_mm");
    for (int m = 0; m < METHOD_COUNT; m++)
        if (w->method_on[m])
            append(text, ",%s_mean_mm,%s_median_mm,%s_most_mm,%s_markers_mm,%s_distance_mm,%s_stop", method_names[m],
                   method_names[m], method_names[m], method_names[m], method_names[m], method_names[m]);
    if (w->method_on[METHOD_INFER])
        append(text, ",infer_expected_mm,infer_flagged");
    append(text, "\n");
}

static void write_row(const work *w, int k, int pattern, char *text)
{
    text[0] = 0;
    append(text, "%d,%d,%s,%.6g,%.6g", k, w->seed, pattern_names[pattern], w->mean_way, w->most_way);
    for (int m = 0; m < METHOD_COUNT; m++) {
        const score *s = &w->scores[pattern][m];
        if (w->method_on[m] && s->ran)
            append(text, ",%.6g,%.6g,%.6g,%.6g,%.6g,%s", s->mean, s->median, s->most, s->marker_mean, s->distance,
                   s->stop);
        else if (w->method_on[m])
            append(text, ",,,,,,failed");
    }
    if (w->method_on[METHOD_INFER] && w->scores[pattern][METHOD_INFER].ran)
        append(text, ",%.6g,%d", w->scores[pattern][METHOD_INFER].expected, w->scores[pattern][METHOD_INFER].flagged);
    else if (w->method_on[METHOD_INFER])
        append(text, ",,");
    append(text, "\n");
}

/* The case of number k: all seeds of a pattern before the next pattern would make the first shards wait for the
 * slowest; so patterns take turns. */
static int run_case(work *w, shard *s, int k)
{
    char row[STUDY_TEXT];
    int pattern = 0, status;
    for (int skip = k % patterns_on(w); !w->pattern_on[pattern] || skip > 0; pattern++)
        skip -= w->pattern_on[pattern];
    w->seed = w->set->seed + k / patterns_on(w);
    for (int m = 0; m < METHOD_COUNT; m++)
        w->scores[pattern][m].ran = 0;
    status = run_pattern(w, pattern);
    if (status && status != EXIT_FAILED)
        return status;
    write_row(w, k, pattern, row);
    return shard_write(s, row) ? status : EXIT_USAGE;
}

static int run_study(work *w, shard *s)
{
    char heading[STUDY_TEXT];
    int cases = w->set->seeds * patterns_on(w), status = 0, failed = 0;
    write_heading(w, cases, heading);
    if (!shard_open(s, w->set->study, heading, cases))
        return EXIT_USAGE;
    printf("study: %d cases, shard %d of %d, %d to do\n", cases, s->index + 1, s->count, s->left);
    if (s->left > 0)
        status = make_organ(w, w->path);
    for (int k = 0; k < cases && !status; k++)
        if (shard_is_mine(s, k)) {
            status = run_case(w, s, k);
            failed += status == EXIT_FAILED;
            status = status == EXIT_FAILED ? 0 : status;
        }
    if (failed)
        fprintf(stderr, "study: a method failed in %d cases, and their rows say so\n", failed);
    return status;
}

/* ---- the command line ------------------------------------------------------------------------------------------ */

/* Turns on what a list with commas names. */
static int choose(const char *option_name, const char *list, const char *const *names, int count, int *on)
{
    if (strcmp(list, "all") == 0) {
        for (int i = 0; i < count; i++)
            on[i] = 1;
        return 0;
    }
    while (*list) {
        size_t length = strcspn(list, ",");
        int i = 0;
        while (i < count && (strlen(names[i]) != length || strncmp(names[i], list, length) != 0))
            i++;
        if (i == count) {
            fprintf(stderr, "insilico: %s: %.*s is none of:", option_name, (int)length, list);
            for (i = 0; i < count; i++)
                fprintf(stderr, " %s", names[i]);
            fputs(" all\n", stderr);
            return EXIT_USAGE;
        }
        on[i] = 1;
        list += length + (list[length] == ',');
    }
    return 0;
}

static void free_work(work *w)
{
    for (int p = 0; p < PATTERNS; p++)
        for (int m = 0; m < METHOD_COUNT; m++)
            free(w->scores[p][m].volume);
    sb_body_destroy(w->body);
    sb_mesh_free(&w->organ);
    sb_mesh_free(&w->model);
    sb_mesh_free(&w->skin);
    sb_mesh_free(&w->outline);
    sb_boundary_free(&w->boundary);
    free(w->fixed);
    free(w->held);
    free(w->truth);
}

static int run(work *w)
{
    int status = make_organ(w, w->path), failed = 0;
    if (status)
        return status;
    printf("organ: %d nodes, %d elements, %.3f l; model: %d nodes, %d elements\n", w->organ.node_count,
           w->organ.element_count, 1e3 * (double)sb_mesh_volume(&w->organ), w->model.node_count,
           w->model.element_count);
    for (int p = 0; !status && p < PATTERNS; p++)
        if (w->pattern_on[p]) {
            status = run_pattern(w, p);
            failed |= status == EXIT_FAILED;
            status = status == EXIT_FAILED ? 0 : status;
        }
    if (!status)
        status = write_picture(w);
    return status ? status : failed ? EXIT_FAILED : 0;
}

/* The camera's direction; a view of a part is partial. */
static int choose_view(settings *set, work *w)
{
    row item;
    w->view = sb_v3(REAL(-0.25), REAL(-0.66), REAL(0.71));
    if (set->from) {
        if (rows_parse(set->from, &item) != 1 || item.count != 3) {
            complain("--from", "is not X,Y,Z");
            return 0;
        }
        w->view = sb_v3(REAL(item.values[0]), REAL(item.values[1]), REAL(item.values[2]));
    }
    if (!(sb_v3_norm(w->view) > 0)) {
        complain("--from", "0,0,0 is no direction");
        return 0;
    }
    w->view = sb_v3_scale(1 / sb_v3_norm(w->view), w->view);
    set->partial = set->partial || set->from || set->seen > 0;
    return 1;
}

static int program(int argc, char **argv)
{
    settings set = {"all",
                    "pbsm,nicp,icp,cpd",
                    "insilico.svg",
                    NULL,
                    "1/1",
                    NULL,
                    0,
                    0,
                    0,
                    0,
                    12,
                    32,
                    1,
                    10,
                    0,
                    1,
                    0.08,
                    0,
                    0,
                    10,
                    20,
                    0,
                    0};
    const char *file = NULL;
    const option options[] = {
        {"--patterns", "LIST", OPTION_TEXT, NULL, NULL, &set.patterns, 0, 0,
         "respiration, instrument, pneumoperitoneum, gravity, with commas between"},
        {"--methods", "LIST", OPTION_TEXT, NULL, NULL, &set.methods, 0, 0,
         "pbsm, pbsm-laplace, nicp, icp, cpd, infer, or all"},
        {"--partial", NULL, OPTION_FLAG, &set.partial, NULL, NULL, 0, 0, "only what a camera above sees"},
        {"--from", "X,Y,Z", OPTION_TEXT, NULL, NULL, &set.from, 0, 0,
         "direction from the organ to the camera, of which only what it sees is there"},
        {"--seen", "P", OPTION_NUMBER, NULL, &set.seen, NULL, 0.01, 100,
         "per cent of the surface, of what a camera sees about the middle of its view"},
        {"--linear", NULL, OPTION_FLAG, &set.linear, NULL, NULL, 0, 0, "linear instead of corotated models"},
        {"--plain", NULL, OPTION_FLAG, &set.plain, NULL, NULL, 0, 0,
         "pbsm only: without the loads that say more of motion along the surface"},
        {"--fix", NULL, OPTION_FLAG, &set.fix, NULL, NULL, 0, 0, "the methods are told what was held"},
        {"--amplitude", "S", OPTION_NUMBER, NULL, &set.amplitude, NULL, 0, 0.5,
         "largest motion that is prescribed, in organ sizes"},
        {"--noise", "MM", OPTION_NUMBER, NULL, &set.noise, NULL, 0, 1e3,
         "standard deviation of the target's coordinates"},
        {"--outliers", "P", OPTION_NUMBER, NULL, &set.outliers, NULL, 0, 50, "per cent of points of something else"},
        {"--angle", "DEG", OPTION_NUMBER, NULL, &set.angle, NULL, 0, 180, "the target is turned by that"},
        {"--shift", "MM", OPTION_NUMBER, NULL, &set.shift, NULL, 0, 1e6, "and moved by that"},
        {"--coarse", "N", OPTION_INTEGER, &set.coarse, NULL, NULL, 3, 200, "cells of the model along the longest side"},
        {"--fine", "N", OPTION_INTEGER, &set.fine, NULL, NULL, 3, 400, "cells of the organ"},
        {"--scale", "S", OPTION_NUMBER, NULL, &set.scale, NULL, 1e-9, 1e9, "unit of the file in m: 0.001 for mm"},
        {"--seed", "N", OPTION_INTEGER, &set.seed, NULL, NULL, 0, 1e9, "of chance"},
        {"--study", "FILE", OPTION_TEXT, NULL, NULL, &set.study, 0, 0,
         "a row (CSV) for each pattern and seed; no plot"},
        {"--seeds", "N", OPTION_INTEGER, &set.seeds, NULL, NULL, 1, 1e6, "of a study, from --seed on"},
        {"--shard", "I/N", OPTION_TEXT, NULL, NULL, &set.shard, 0, 0, "the I-th of N shares of a study"},
        {"--seconds", "T", OPTION_NUMBER, NULL, &set.seconds, NULL, 1e-6, 1e9,
         "most time of each method; 30 by default, and no end in a study, whose rows must not depend on the machine"},
        {"-o", "FILE", OPTION_TEXT, NULL, NULL, &set.out, 0, 0, "the box plot (SVG)"},
        {"--help", NULL, OPTION_FLAG, &set.help, NULL, NULL, 0, 0, "this text"},
    };
    const int count = (int)(sizeof options / sizeof options[0]);
    work w;
    shard s;
    int status;
    memset(&w, 0, sizeof w);
    w.set = &set;
    if (!options_parse("insilico", options, count, &file, 1, argc, argv))
        return EXIT_USAGE;
    if (set.help) {
        puts("insilico [MODEL] [OPTIONS]: deforms an organ and measures how well methods of registration find out");
        options_print(options, count);
        return 0;
    }
    if (choose("--patterns", set.patterns, pattern_names, PATTERNS, w.pattern_on) ||
        choose("--methods", set.methods, method_names, METHOD_COUNT, w.method_on))
        return EXIT_USAGE;
    if (!choose_view(&set, &w))
        return EXIT_USAGE;
    if (file && is_same_file(set.study ? set.study : set.out, file))
        return complain(set.study ? set.study : set.out, "is the input file");
    if (!shard_parse("insilico", set.shard, &s))
        return EXIT_USAGE;
    if (!set.study && s.count > 1)
        return complain("--shard", "needs --study FILE, where the rows go");
    w.path = file;
    w.seed = set.seed;
    status = set.study ? run_study(&w, &s) : run(&w);
    shard_close(&s);
    free_work(&w);
    return status;
}

int main(int argc, char **argv) { return finish("insilico", program(argc, argv), EXIT_USAGE); }
