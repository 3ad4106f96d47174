/* breathing: a liver under the diaphragm, which breathes and beats, 60 frames a second.
 *
 *     breathing [ORGAN] [OPTIONS]      breathing --help lists the options
 *
 * Without a file an organ like a liver is made; z is towards the head. The diaphragm lies on it, a rigid
 * dome that it slides along, and goes down with each breath; the heart rests on the part towards +x and beats. With
 * --bound the organ's upper side goes where the diaphragm goes, as the bare area of a liver does, and slides across
 * only: its nodes are prescribed. Below it lie soft viscera, springs per area. The shape at rest is that of the end of
 * a breath, as images show it, with gravity and the bed in balance; so no gravity is added.
 *
 * The depth of a breath goes as the fourth power of a sine: it rests at the end of breathing out (Lujan, Larsen, Balter
 * and Ten Haken 1999, with n = 2). Written are motions, forces and frame times (CSV and chart), a picture of the
 * deepest breath, and frames for ParaView on request. Exit status: 0, 2 wrong usage or a file that cannot be read or
 * written, 3 a step failed or memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "options.h"
#include "organ_scene.h"
#include "plot.h"

#define REAL(x) ((sb_real)(x)) /* everything here computes in double, the body in sb_real */

static const char *const program_name = "breathing";

typedef struct settings {
    const char *organ, *out;
    double scale, young, poisson, density, breath, period, beat, pulse, bed, seconds, rate;
    int cells, bound, every, help;
} settings;

/* What was measured in each frame. */
enum { TIME, DIAPHRAGM, HEART, TARGET, LARGEST, FORCE, VOLUME, FRAME, COLUMNS };
static const char *const column_names[COLUMNS] = {"time_s",     "diaphragm_mm", "heart_mm",       "target_mm",
                                                  "largest_mm", "force_N",      "volume_percent", "frame_ms"};

typedef struct work {
    const settings *set;
    organ scene;
    sb_vec3 beat_at;     /* where the heart touches (m) */
    double heart;        /* m, its radius; */
    sb_vec3 heart_at;    /* its middle at rest (m) */
    int dome, heart_top; /* tools */
    sb_mesh slab;        /* of the dome */
    int *upper, upper_count;
    sb_vec3 *goes; /* [upper_count] where they are sent (m, of displacements) */
    int target;    /* node nearest to the middle of the organ: what a radiotherapist would aim at */
    double volume; /* m^3, at rest */
    double *columns[COLUMNS];
    int frames, room;
    double deepest; /* m, of the picture */
    sb_vec3 *deepest_places;
    sb_real *deepest_ways; /* m */
} work;

/* ---- motions --------------------------------------------------------------------------------------------------- */

/* From 0 to 1 and back once in each period, with a rest at 0. */
static double swell(double periods)
{
    double s = sin(3.14159265358979323846 * periods);
    return s * s * s * s;
}

/* How far below its place at rest the diaphragm is (m). */
static double breath_at(const work *w, double t) { return w->set->breath * swell(t / w->set->period); }

/* How far the heart goes beyond it (m). */
static double beat_at(const work *w, double t) { return w->set->beat * swell(t * w->set->pulse / 60); }

/* ---- the scene ------------------------------------------------------------------------------------------------- */

static int make_mesh(work *w)
{
    const settings *s = w->set;
    sb_error error;
    w->scene = organ_named(program_name);
    if (s->organ) {
        int status = organ_load(&w->scene, s->organ, s->scale);
        if (status)
            return status;
    } else if (sb_mesh_organ(SB_TET4, s->cells, NULL, &w->scene.mesh, &error) != SB_OK) {
        return organ_complain_of(&w->scene, "the organ", &error, ORGAN_USAGE);
    }
    w->volume = (double)sb_mesh_volume(&w->scene.mesh);
    return organ_make_skin(&w->scene);
}

/* Where the heart lies: the highest place of the part towards +x. */
static void find_heart(work *w)
{
    const organ *o = &w->scene;
    const sb_mesh *skin = &o->boundary.surface;
    const double low = (double)o->low.x, width = (double)o->high.x - low;
    int best = -1;
    for (int i = 0; i < skin->node_count; i++) {
        double share = ((double)skin->nodes[i].x - low) / width;
        if (share > 0.65 && share < 0.9 && (best < 0 || skin->nodes[i].z > skin->nodes[best].z))
            best = i;
    }
    w->heart = 0.12 * width;
    w->beat_at = best >= 0 ? skin->nodes[best] : o->high;
    w->heart_at = sb_v3(w->beat_at.x, w->beat_at.y, o->high.z + REAL(1.5 * w->heart));
    for (int i = 0; i < 200; i++) { /* let down until it touches */
        double room = (double)sb_surface_signed_distance(o->skin, w->heart_at, NULL) - 1.005 * w->heart;
        if (room < 1e-3 * w->heart)
            break;
        w->heart_at.z -= REAL(room);
    }
}

static void find_target(work *w)
{
    const organ *o = &w->scene;
    sb_vec3 middle = sb_v3_scale(REAL(0.5), sb_v3_add(o->low, o->high));
    for (int i = 0; i < o->mesh.node_count; i++)
        if (sb_v3_norm(sb_v3_sub(o->mesh.nodes[i], middle)) < sb_v3_norm(sb_v3_sub(o->mesh.nodes[w->target], middle)))
            w->target = i;
}

/* Viscera below: springs on the faces that look down, `bed` (Pa/m) times the area that a node has of them. */
static int make_bed(work *w)
{
    const organ *o = &w->scene;
    const sb_mesh *skin = &o->boundary.surface;
    const int width = sb_mesh_element_width(skin);
    sb_real *stiffness = (sb_real *)calloc((size_t)skin->node_count, sizeof *stiffness);
    int *nodes = (int *)malloc((size_t)skin->node_count * sizeof *nodes), count = 0;
    sb_vec3 *points = (sb_vec3 *)malloc((size_t)skin->node_count * sizeof *points);
    int status = stiffness && nodes && points ? 0 : organ_complain_memory(o);
    sb_error error;
    for (int f = 0; f < skin->element_count && !status; f++) {
        sb_vec3 area = organ_face_area(o, f);
        for (int a = 0; a < width && area.z < REAL(-0.5) * sb_v3_norm(area); a++)
            stiffness[skin->elements[f * width + a]] += REAL(w->set->bed) * sb_v3_norm(area) / (sb_real)width;
    }
    for (int i = 0; i < skin->node_count && !status; i++)
        if (stiffness[i] > 0) {
            nodes[count] = o->boundary.nodes[i];
            points[count] = skin->nodes[i];
            stiffness[count++] = stiffness[i];
        }
    if (!status && count == 0)
        status = organ_complain(o, "the organ", "has no side that looks down to lie on", ORGAN_USAGE);
    if (!status && sb_body_add_springs(o->body, nodes, count, stiffness, 0, points, NULL, &error) != SB_OK)
        status = organ_complain_of(o, "the bed", &error, ORGAN_FAILED);
    free(stiffness);
    free(nodes);
    free(points);
    return status;
}

static int make_body(work *w)
{
    const settings *s = w->set;
    sb_body_def body = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    int status;
    body.material = sb_material_corotated(REAL(s->young), REAL(s->poisson), REAL(s->density));
    body.gravity = sb_v3(0, 0, 0);
    body.damping_stiffness = REAL(0.01);
    contact.max_contacts = 1 << 15;
    status = organ_make_body(&w->scene, &body, s->bound ? NULL : &contact);
    if (status)
        return status;
    find_heart(w);
    find_target(w);
    return make_bed(w);
}

/* ---- a diaphragm that the organ slides along --------------------------------------------------------------------- */

enum { DOME_CELLS = 32, DOME_SIDE = DOME_CELLS + 1, DOME_NODES = DOME_SIDE * DOME_SIDE };

/* Slope of the slope (1/m) of what fits into the diaphragm from below: of a ball of a quarter of the organ's width. */
static double dome_curvature(const organ *o)
{
    return 4 / fmax((double)(o->high.x - o->low.x), (double)(o->high.y - o->low.y));
}

/* Lowest height at which a bowl, upside down, with its middle over (x, y) is nowhere in the organ. */
static double bowl_height(const organ *o, double x, double y)
{
    double highest = -HUGE_VAL;
    for (int i = 0; i < o->boundary.surface.node_count; i++) {
        sb_vec3 at = o->boundary.surface.nodes[i];
        double dx = (double)at.x - x, dy = (double)at.y - y;
        highest = fmax(highest, (double)at.z + 0.5 * dome_curvature(o) * (dx * dx + dy * dy));
    }
    return highest;
}

/* The organ's upper side without what such bowls do not fit into, down to the middle of its height: z of plan[], whose
 * x and y are given. heights: of bowls over them. */
static void lower_dome(const organ *o, const double *heights, double gap, sb_vec3 *plan)
{
    const double least = 0.5 * (double)(o->low.z + o->high.z), most = (double)o->high.z;
    for (int k = 0; k < DOME_NODES; k++) {
        double lowest = HUGE_VAL;
        for (int b = 0; b < DOME_NODES; b++) {
            double dx = (double)(plan[k].x - plan[b].x), dy = (double)(plan[k].y - plan[b].y);
            lowest = fmin(lowest, heights[b] - 0.5 * dome_curvature(o) * (dx * dx + dy * dy));
        }
        plan[k].z = REAL(fmin(fmax(lowest, least), most) + gap);
    }
}

/* A node of the slab: of its lower side (the dome) or of the upper one, which is flat. */
static int slab_node(int upper, int i, int j) { return (upper * DOME_SIDE + j) * DOME_SIDE + i; }

static int put_quad(int *triangles, int count, int a, int b, int c, int d)
{
    const int made[6] = {a, b, c, a, c, d};
    memcpy(triangles + 3 * (size_t)count, made, sizeof made);
    return count + 2;
}

static int put_slab_triangles(int *triangles)
{
    const int n = DOME_CELLS;
    int count = 0;
    for (int j = 0; j < n; j++)
        for (int i = 0; i < n; i++) {
            count = put_quad(triangles, count, slab_node(0, i, j), slab_node(0, i, j + 1), slab_node(0, i + 1, j + 1),
                             slab_node(0, i + 1, j));
            count = put_quad(triangles, count, slab_node(1, i, j), slab_node(1, i + 1, j), slab_node(1, i + 1, j + 1),
                             slab_node(1, i, j + 1));
        }
    for (int i = 0; i < n; i++) { /* the four sides */
        count = put_quad(triangles, count, slab_node(0, i, 0), slab_node(0, i + 1, 0), slab_node(1, i + 1, 0),
                         slab_node(1, i, 0));
        count = put_quad(triangles, count, slab_node(0, i + 1, n), slab_node(0, i, n), slab_node(1, i, n),
                         slab_node(1, i + 1, n));
        count = put_quad(triangles, count, slab_node(0, 0, i + 1), slab_node(0, 0, i), slab_node(1, 0, i),
                         slab_node(1, 0, i + 1));
        count = put_quad(triangles, count, slab_node(0, n, i), slab_node(0, n, i + 1), slab_node(1, n, i + 1),
                         slab_node(1, n, i));
    }
    return count;
}

/* The dome as the lower side of a closed slab, a tenth of the organ wider than it all round. */
static int make_slab(work *w)
{
    enum { TRIANGLES = 4 * DOME_CELLS * DOME_CELLS + 8 * DOME_CELLS };
    const organ *o = &w->scene;
    const double wide = (double)(o->high.x - o->low.x), deep = (double)(o->high.y - o->low.y);
    const double margin = 0.1 * fmax(wide, deep), gap = 0.05 * margin;
    double *heights = (double *)malloc(DOME_NODES * sizeof *heights);
    sb_vec3 *dome = w->slab.nodes = (sb_vec3 *)malloc(2 * DOME_NODES * sizeof *dome);
    w->slab.element_type = SB_TRI3;
    w->slab.elements = (int *)malloc(3 * TRIANGLES * sizeof *w->slab.elements);
    if (!heights || !dome || !w->slab.elements) {
        free(heights);
        return organ_complain_memory(o);
    }
    for (int k = 0; k < DOME_NODES; k++) {
        double x = (double)o->low.x - margin + (wide + 2 * margin) * (k % DOME_SIDE) / (double)DOME_CELLS;
        double y = (double)o->low.y - margin + (deep + 2 * margin) * (int)(k / DOME_SIDE) / (double)DOME_CELLS;
        heights[k] = bowl_height(o, x, y);
        dome[k] = sb_v3(REAL(x), REAL(y), 0);
        dome[DOME_NODES + k] = sb_v3(REAL(x), REAL(y), o->high.z + REAL(margin));
    }
    lower_dome(o, heights, gap, dome);
    free(heights);
    w->slab.node_count = 2 * DOME_NODES;
    w->slab.element_count = put_slab_triangles(w->slab.elements);
    return 0;
}

static sb_pose heart_pose(const work *w, double down)
{
    sb_pose pose;
    pose.position = sb_v3_sub(w->heart_at, sb_v3(0, 0, REAL(down)));
    pose.rotation = sb_quat_identity();
    return pose;
}

static int add_tools(work *w)
{
    sb_tool_def dome = sb_default_tool_def(), heart = sb_default_tool_def();
    int status = make_slab(w);
    dome.shape = SB_TOOL_MESH;
    dome.surface = &w->slab;
    dome.cells = 24; /* bowls are far wider than two of them */
    heart.shape = SB_TOOL_SPHERE;
    heart.radius = REAL(w->heart);
    heart.pose = heart_pose(w, 0);
    if (!status)
        status = organ_add_tool(&w->scene, &dome, &w->dome);
    if (!status)
        status = organ_add_tool(&w->scene, &heart, &w->heart_top);
    return status;
}

static int move_tools(const work *w, double t)
{
    sb_pose dome, heart = heart_pose(w, breath_at(w, t) + beat_at(w, t));
    dome.position = sb_v3(0, 0, REAL(-breath_at(w, t)));
    dome.rotation = sb_quat_identity();
    if (sb_contact_move_tool(w->scene.contact, w->dome, &dome) != SB_OK ||
        sb_contact_move_tool(w->scene.contact, w->heart_top, &heart) != SB_OK)
        return organ_complain(&w->scene, "the diaphragm", "cannot go there", ORGAN_FAILED);
    return 0;
}

/* ---- a diaphragm that the organ is bound to ---------------------------------------------------------------------- */

/* The nodes of the faces that look up. */
static int find_upper(work *w)
{
    const organ *o = &w->scene;
    const sb_mesh *skin = &o->boundary.surface;
    const int width = sb_mesh_element_width(skin);
    unsigned char *seen = (unsigned char *)calloc((size_t)skin->node_count, 1);
    w->upper = (int *)malloc((size_t)skin->node_count * sizeof *w->upper);
    w->goes = (sb_vec3 *)calloc((size_t)skin->node_count, sizeof *w->goes);
    if (!seen || !w->upper || !w->goes) {
        free(seen);
        return organ_complain_memory(o);
    }
    for (int f = 0; f < skin->element_count; f++) {
        sb_vec3 area = organ_face_area(o, f);
        for (int a = 0; a < width && area.z > REAL(0.5) * sb_v3_norm(area); a++)
            seen[skin->elements[f * width + a]] = 1;
    }
    for (int i = 0; i < skin->node_count; i++)
        if (seen[i])
            w->upper[w->upper_count++] = o->boundary.nodes[i];
    free(seen);
    return w->upper_count ? 0
                          : organ_complain(o, "the organ", "has no side that looks up to the diaphragm", ORGAN_USAGE);
}

/* Down with the breath, and by the heart's beat about where that lies. */
static int move_upper(const work *w, double t)
{
    for (int k = 0; k < w->upper_count; k++) {
        double off = (double)sb_v3_norm(sb_v3_sub(w->scene.mesh.nodes[w->upper[k]], w->beat_at)) / w->heart;
        w->goes[k].z = REAL(-breath_at(w, t) - beat_at(w, t) * exp(-off * off));
    }
    return sb_body_prescribe(w->scene.body, w->upper, w->upper_count, SB_Z, w->goes, 0) == SB_OK
               ? 0
               : organ_complain_memory(&w->scene);
}

static int make_diaphragm(work *w) { return w->set->bound ? find_upper(w) : add_tools(w); }

static int move_diaphragm(const work *w, double t) { return w->set->bound ? move_upper(w, t) : move_tools(w, t); }

/* ---- the run --------------------------------------------------------------------------------------------------- */

static int take_memory(work *w)
{
    size_t nodes = (size_t)w->scene.mesh.node_count;
    int there = 1;
    w->room = (int)ceil(w->set->seconds * w->set->rate);
    for (int c = 0; c < COLUMNS; c++) {
        w->columns[c] = (double *)calloc((size_t)w->room, sizeof(double));
        there = there && w->columns[c];
    }
    w->deepest_places = (sb_vec3 *)malloc(nodes * sizeof *w->deepest_places);
    w->deepest_ways = (sb_real *)calloc(nodes, sizeof *w->deepest_ways);
    if (!there || !w->deepest_places || !w->deepest_ways)
        return organ_complain_memory(&w->scene);
    memcpy(w->deepest_places, w->scene.mesh.nodes, nodes * sizeof *w->deepest_places);
    return 0;
}

/* Push (N) of diaphragm and heart towards the feet. */
static double read_force(const work *w)
{
    sb_wrench dome, heart;
    sb_vec3 force = sb_v3(0, 0, 0);
    if (w->set->bound) {
        sb_body_wrench(w->scene.body, w->upper, w->upper_count, sb_v3(0, 0, 0), &force, NULL, NULL);
        return -(double)force.z;
    }
    sb_contact_wrench(w->scene.contact, w->dome, &dome);
    sb_contact_wrench(w->scene.contact, w->heart_top, &heart);
    return (double)(dome.force.z + heart.force.z);
}

static void read_frame(work *w, double t)
{
    organ *o = &w->scene;
    const sb_vec3 *u = sb_body_displacements(o->body);
    const int nodes = o->mesh.node_count, f = w->frames;
    sb_mesh deformed = o->mesh;
    double largest = 0;
    for (int i = 0; i < nodes; i++)
        largest = fmax(largest, (double)sb_v3_norm(u[i]));
    memcpy(o->places, sb_body_positions(o->body), (size_t)nodes * sizeof *o->places);
    deformed.nodes = o->places;
    w->columns[TIME][f] = t;
    w->columns[DIAPHRAGM][f] = 1e3 * breath_at(w, t);
    w->columns[HEART][f] = 1e3 * (breath_at(w, t) + beat_at(w, t));
    w->columns[TARGET][f] = 1e3 * (double)sb_v3_norm(u[w->target]);
    w->columns[LARGEST][f] = 1e3 * largest;
    w->columns[FORCE][f] = read_force(w);
    w->columns[VOLUME][f] = 100 * ((double)sb_mesh_volume(&deformed) / w->volume - 1);
    w->columns[FRAME][f] = 1e3 * o->seconds;
    if (largest > w->deepest) {
        w->deepest = largest;
        memcpy(w->deepest_places, o->places, (size_t)nodes * sizeof *o->places);
        for (int i = 0; i < nodes; i++)
            w->deepest_ways[i] = sb_v3_norm(u[i]);
    }
}

static int run_frames(work *w)
{
    const double dt = 1 / w->set->rate;
    int status = 0;
    while (w->frames < w->room && !status) {
        double t = (w->frames + 1) * dt, begun = seconds_now();
        status = move_diaphragm(w, t);
        if (!status)
            status = organ_step(&w->scene, dt);
        if (status)
            break;
        w->scene.seconds = seconds_now() - begun; /* with what moved the diaphragm */
        read_frame(w, t);
        progress_show((double)w->frames / w->room, "breathing");
        w->frames++;
        if (w->set->every > 0 && w->frames % w->set->every == 0)
            status = organ_write_frame(&w->scene, w->set->out);
    }
    progress_end();
    return status;
}

/* ---- what is written ------------------------------------------------------------------------------------------- */

static int write_table(work *w)
{
    char path[ORGAN_PATH + 32];
    sb_output out;
    snprintf(path, sizeof path, "%s.csv", w->set->out);
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return organ_complain_file(&w->scene, path);
    for (int c = 0; c < COLUMNS; c++)
        fprintf(out.file, "%s%s", column_names[c], c + 1 < COLUMNS ? "," : "\n");
    for (int i = 0; i < w->frames; i++)
        for (int c = 0; c < COLUMNS; c++)
            fprintf(out.file, "%.6g%s", w->columns[c][i], c + 1 < COLUMNS ? "," : "\n");
    return sb_output_close(&out, NULL) == SB_OK ? 0 : organ_complain_file(&w->scene, path);
}

static int write_chart(work *w)
{
    char path[ORGAN_PATH + 32];
    plot p;
    plot_panel *panel;
    plot_begin(&p, "A liver under the diaphragm");
    panel = plot_add_panel(&p, "how far they go", "time (s)", "way (mm)");
    plot_add_curve(panel, "diaphragm", w->columns[TIME], w->columns[DIAPHRAGM], w->frames);
    plot_add_curve(panel, "heart", w->columns[TIME], w->columns[HEART], w->frames);
    plot_add_curve(panel, "middle of the organ", w->columns[TIME], w->columns[TARGET], w->frames);
    panel = plot_add_panel(&p, "what the organ feels of both", "time (s)", "force (N)");
    plot_add_curve(panel, "push", w->columns[TIME], w->columns[FORCE], w->frames);
    panel = plot_add_panel(&p, "time of a frame", "time (s)", "frame (ms)");
    plot_add_curve(panel, "frame", w->columns[TIME], w->columns[FRAME], w->frames);
    snprintf(path, sizeof path, "%s.svg", w->set->out);
    return plot_save_svg(&p, path) ? 0 : organ_complain_file(&w->scene, path);
}

static int draw_picture(work *w)
{
    const int width = 1280, height = 960;
    char path[ORGAN_PATH + 32], title[128], details[160];
    picture p;
    picture_begin(&p, width, height);
    for (int i = 0; i < w->scene.mesh.node_count; i++)
        w->scene.numbers[i] = REAL(1e3) * w->deepest_ways[i];
    organ_draw(&w->scene, &p, w->deepest_places, w->scene.numbers, 1e3 * w->deepest);
    picture_render(&p, 28, 24);
    picture_colour_bar(&p, "way from rest", "mm", 0, 1e3 * w->deepest, 1e3 * w->deepest);
    picture_length_bar(&p);
    snprintf(title, sizeof title, "Breathed in by %.3g mm", 1e3 * w->set->breath);
    snprintf(details, sizeof details, "%d %s, E %.4g kPa, nu %.3g, %s", w->scene.mesh.element_count,
             sb_element_name(w->scene.mesh.element_type), 1e-3 * w->set->young, w->set->poisson,
             w->set->bound ? "bound to the diaphragm" : "slides along the diaphragm");
    picture_text(&p, 0.06 * width, 0.075 * height, 22, PICTURE_LEFT, picture_ink(), title);
    picture_text(&p, 0.06 * width, 0.115 * height, 14, PICTURE_LEFT, picture_ink(), details);
    snprintf(path, sizeof path, "%s.png", w->set->out);
    return organ_save_picture(&w->scene, &p, path);
}

static int write_frames(work *w)
{
    return w->scene.frames ? organ_write_series(&w->scene, w->set->out, w->set->every / w->set->rate) : 0;
}

static double largest_of(const double *values, int count)
{
    double largest = 0;
    for (int i = 0; i < count; i++)
        largest = fmax(largest, fabs(values[i]));
    return largest;
}

static int print_summary(work *w)
{
    const double budget = 1e3 / w->set->rate;
    double *frame = w->columns[FRAME];
    int late = 0;
    for (int i = 0; i < w->frames; i++)
        late += frame[i] > budget;
    printf("organ       %s: %d nodes, %d %s, %.0f ml; %s\n", w->set->organ ? w->set->organ : "like a liver",
           w->scene.mesh.node_count, w->scene.mesh.element_count, sb_element_name(w->scene.mesh.element_type),
           1e6 * w->volume, w->set->bound ? "its upper side is bound to the diaphragm" : "slides along the diaphragm");
    printf("breath      %.3g mm in %.3g s, heart %.3g mm at %.3g a minute; the volume changed by at most %.2f %%\n",
           1e3 * w->set->breath, w->set->period, 1e3 * w->set->beat, w->set->pulse,
           largest_of(w->columns[VOLUME], w->frames));
    printf("written     %s.csv, %s.svg, %s.png", w->set->out, w->set->out, w->set->out);
    if (w->scene.frames)
        printf(", %s_0000.vtk to _%04d.vtk; ParaView opens %s.vtk.series", w->set->out, w->scene.frames - 1,
               w->set->out);
    printf("\ntarget_mm=%.3g largest_mm=%.3g force_N=%.3g frames=%d", largest_of(w->columns[TARGET], w->frames),
           1e3 * w->deepest, largest_of(w->columns[FORCE], w->frames), w->frames);
    organ_median(frame, w->frames); /* sorts them */
    printf(" median_ms=%.2f p99_ms=%.2f worst_ms=%.2f late=%d\n", frame[w->frames / 2], frame[w->frames * 99 / 100],
           frame[w->frames - 1], late);
    return 0;
}

static void release(work *w)
{
    organ_free(&w->scene);
    sb_mesh_free(&w->slab);
    for (int c = 0; c < COLUMNS; c++)
        free(w->columns[c]);
    free(w->upper);
    free(w->goes);
    free(w->deepest_places);
    free(w->deepest_ways);
}

static int run(const settings *set)
{
    static int (*const stages[])(work *) = {make_mesh,   make_body,   make_diaphragm, take_memory,  run_frames,
                                            write_table, write_chart, draw_picture,   write_frames, print_summary};
    work w;
    int status = 0;
    memset(&w, 0, sizeof w);
    w.set = set;
    for (size_t i = 0; i < sizeof stages / sizeof stages[0] && !status; i++)
        status = stages[i](&w);
    release(&w);
    return status;
}

/* ---- command line ---------------------------------------------------------------------------------------------- */

static settings default_settings(void)
{
    settings s;
    memset(&s, 0, sizeof s);
    s.out = program_name;
    s.scale = 1;
    s.young = 8000;
    s.poisson = 0.45;
    s.density = 1060;
    s.breath = 0.015;
    s.period = 4;
    s.beat = 0.002;
    s.pulse = 70;
    s.bed = 3e4;
    s.seconds = 8;
    s.rate = 60;
    s.cells = 12;
    return s;
}

enum { OPTION_COUNT = 17 };
static void list_options(settings *s, option options[OPTION_COUNT])
{
    const option all[OPTION_COUNT] = {
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &s->out, 0, 0, "files are NAME.csv, NAME.svg, NAME.png"},
        {"--scale", "X", OPTION_NUMBER, NULL, &s->scale, NULL, 1e-9, 1e9,
         "multiplies the file's lengths; 0.001 for millimetres"},
        {"--cells", "N", OPTION_INTEGER, &s->cells, NULL, NULL, 4, 60, "of the organ that is made, over its width"},
        {"--bound", NULL, OPTION_FLAG, &s->bound, NULL, NULL, 0, 0,
         "the organ's upper side goes with the diaphragm; without: it slides along it"},
        {"--breath", "M", OPTION_NUMBER, NULL, &s->breath, NULL, 0, 0.05, "how far the diaphragm goes down (m)"},
        {"--period", "S", OPTION_NUMBER, NULL, &s->period, NULL, 0.2, 60, "of a breath (s)"},
        {"--beat", "M", OPTION_NUMBER, NULL, &s->beat, NULL, 0, 0.02, "how far the heart goes down (m)"},
        {"--pulse", "N", OPTION_NUMBER, NULL, &s->pulse, NULL, 0, 300, "its beats a minute"},
        {"--young", "PA", OPTION_NUMBER, NULL, &s->young, NULL, 1, 1e9, "Young's modulus (Pa)"},
        {"--poisson", "NU", OPTION_NUMBER, NULL, &s->poisson, NULL, 0, 0.49, "Poisson's ratio"},
        {"--density", "RHO", OPTION_NUMBER, NULL, &s->density, NULL, 1, 1e5, "density (kg/m^3)"},
        {"--bed", "PA/M", OPTION_NUMBER, NULL, &s->bed, NULL, 1, 1e9, "stiffness of what lies below, per area"},
        {"--seconds", "S", OPTION_NUMBER, NULL, &s->seconds, NULL, 0.1, 3600, "how long to look"},
        {"--rate", "HZ", OPTION_NUMBER, NULL, &s->rate, NULL, 10, 1000, "frames a second"},
        {"--every", "K", OPTION_INTEGER, &s->every, NULL, NULL, 0, 1e6,
         "write every K-th frame as NAME_0000.vtk and so on; 0 (default): none"},
        {"--help", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, "this text"},
        {"-h", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, NULL},
    };
    memcpy(options, all, sizeof all);
}

static int program(int argc, char **argv)
{
    settings s = default_settings();
    option options[OPTION_COUNT];
    list_options(&s, options);
    if (!options_parse(program_name, options, OPTION_COUNT, &s.organ, 1, argc, argv))
        return ORGAN_USAGE;
    if (s.help) {
        s = default_settings();
        list_options(&s, options);
        printf("usage: breathing [ORGAN] [OPTIONS]\n\n"
               "A liver that is pushed by the diaphragm with each breath and by the heart with each beat. ORGAN: a\n"
               "volume mesh in metres (VTK, VTU, gmsh, Medit or TetGen) with z towards the head; without it one like\n"
               "a liver is made.\n\n");
        options_print(options, OPTION_COUNT);
        printf(
            "\nThe last line: the largest way of the node in the organ's middle and of any node, the largest push of\n"
            "diaphragm and heart, and the times of frames: median, 99 %% and worst, and how many were late.\n");
        return 0;
    }
    return organ_check_name(program_name, "-o", s.out) ? run(&s) : ORGAN_USAGE;
}

int main(int argc, char **argv) { return finish(program_name, program(argc, argv), ORGAN_USAGE); }
