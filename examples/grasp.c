/* grasp: two jaws grip an organ, lift it and pull until it slips out.
 *
 *     grasp [ORGAN] [OPTIONS]      grasp --help lists the options
 *
 * Without a file a flap of 60 x 20 x 6 mm is made. The jaws close above and below the thinnest place of its rim to -x,
 * x, -y or y; what lies farthest from there is held. Written are the forces over time (CSV and chart), a picture at the
 * largest pull, and frames for ParaView on request. Grip: mean force of a jaw along its way to the other; pull: force
 * of both outward; friction holds mu times what both jaws press, whichever way its parts point. Slip: how far the nodes
 * that the jaws pressed on when they had closed were left behind. Exit status: 0, 2 wrong usage or a file that cannot
 * be read or written, 3 a step failed or memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "options.h"
#include "organ_scene.h"
#include "plot.h"

#define REAL(x) ((sb_real)(x)) /* everything here computes in double, the body in sb_real */

static const char *const program_name = "grasp";
static const double gap = 2e-4;      /* m, of the jaws from the organ before */
static const double hold_time = 0.3; /* s, between closing, lifting and pulling */

typedef struct settings {
    const char *organ, *out;
    double scale, mu, young, poisson, density, speed, squeeze, lift, way, held, dt;
    double length, width, thickness; /* m, of a jaw: along the pull and across it, 0: as suits; along its way */
    double flap[3];                  /* m */
    int cells, every, help;
} settings;

/* What was measured in each step. */
enum { TIME, GRIP, PULL, LIFT, BOUND, SLIP, STICKING, COLUMNS };
static const char *const column_names[COLUMNS] = {"time_s", "grip_N",  "pull_N",  "lift_N",
                                                  "mu_N_N", "slip_mm", "sticking"};

typedef struct work {
    const settings *set;
    organ scene;
    double length, width; /* m, of a jaw: along the pull, across it */
    sb_vec3 out;          /* outward, the way of the pull */
    sb_vec3 place;        /* between the jaws (m) */
    double heights;       /* m, of the organ between the jaws */
    int jaws[2];          /* above and below */
    sb_vec3 half;         /* of a jaw */
    sb_vec3 shift;        /* of both jaws since they closed (m) */
    double closed;        /* m that each has gone */
    double *columns[COLUMNS];
    double *milliseconds;
    int steps, room;
    int *gripped, gripped_count; /* nodes that they pressed on when they had closed */
    sb_vec3 *gripped_at;
    sb_contact_point *points; /* [room of the contact] */
    int point_room;
    int slides;        /* 1: it has slipped by a tenth of a jaw */
    double peak;       /* N, the largest pull before */
    double peak_bound; /* N, what friction held then */
    sb_vec3 *peak_places, peak_jaws[2];
    sb_real *peak_stress;
} work;

/* ---- the scene ------------------------------------------------------------------------------------------------- */

static int make_mesh(work *w)
{
    const settings *s = w->set;
    int n[3];
    sb_error error;
    w->scene = organ_named(program_name);
    if (s->organ) {
        int status = organ_load(&w->scene, s->organ, s->scale);
        return status ? status : organ_make_skin(&w->scene);
    }
    for (int k = 0; k < 3; k++) { /* cells about as long as they are wide, two at least through the thickness */
        double cell = s->flap[1] / s->cells;
        n[k] = (int)fmax(k == 2 ? 2 : 1, floor(s->flap[k] / cell + 0.5));
    }
    if (sb_mesh_beam(SB_TET4, n[0], n[1], n[2], sb_v3(REAL(s->flap[0]), REAL(s->flap[1]), REAL(s->flap[2])), NULL,
                     &w->scene.mesh, &error) != SB_OK)
        return organ_complain_of(&w->scene, "the flap", &error, ORGAN_USAGE);
    return organ_make_skin(&w->scene);
}

/* Heights (z, m) between which the organ is where a jaw with these half extents would close. Returns the share of the
 * jaw's face that has organ before it. */
static double find_heights(const organ *o, sb_vec3 at, sb_vec3 half, double *low, double *high)
{
    const int rays = 9; /* along each side */
    sb_real reach = o->high.z - o->low.z;
    int hits = 0;
    *low = HUGE_VAL, *high = -HUGE_VAL;
    for (int i = 0; i < rays * rays; i++) {
        double u = (2.0 * (i % rays) + 1) / rays - 1, v = (2.0 * (int)(i / rays) + 1) / rays - 1;
        sb_vec3 from = sb_v3(at.x + REAL(u) * half.x, at.y + REAL(v) * half.y, o->high.z + reach);
        sb_surface_hit hit;
        if (!sb_surface_ray(o->skin, from, sb_v3(0, 0, -1), SB_REAL_MAX, &hit))
            continue;
        hits++;
        *high = fmax(*high, (double)hit.point.z);
        from.z = o->low.z - reach;
        if (sb_surface_ray(o->skin, from, sb_v3(0, 0, 1), SB_REAL_MAX, &hit))
            *low = fmin(*low, (double)hit.point.z);
    }
    return hits / (double)(rays * rays);
}

static sb_vec3 jaw_half(const work *w, sb_vec3 out)
{
    sb_real length = REAL(w->length / 2), width = REAL(w->width / 2), thickness = REAL(w->set->thickness / 2);
    return out.x != 0 ? sb_v3(length, width, thickness) : sb_v3(width, length, thickness);
}

/* Jaws as long and wide as asked for, else as suits the organ. */
static int choose_jaws(work *w)
{
    const organ *o = &w->scene;
    double longest = fmax((double)(o->high.x - o->low.x), (double)(o->high.y - o->low.y));
    w->length = w->set->length > 0 ? w->set->length : w->set->organ ? 0.15 * longest : 0.8 * w->set->flap[1];
    w->width = w->set->width > 0 ? w->set->width : w->set->organ ? 0.15 * longest : 1.2 * w->set->flap[1];
    return w->length > w->set->thickness && w->width > w->set->thickness
               ? 0
               : organ_complain(o, "--thickness", "of a jaw needs to be less than its length and width", ORGAN_USAGE);
}

/* Looks at one place of the rim, where the organ ends to `out` between the heights that a jaw's width takes. */
static void try_place(work *w, sb_vec3 out, double across)
{
    const organ *o = &w->scene;
    const sb_mesh *skin = &o->boundary.surface;
    const double least_cover = 0.6; /* of a jaw's face */
    sb_vec3 half = jaw_half(w, out), at;
    double low, high;
    int tip = -1;
    for (int i = 0; i < skin->node_count; i++) {
        double off = (double)(out.x != 0 ? skin->nodes[i].y : skin->nodes[i].x) - across;
        if (fabs(off) <= w->width / 2 && (tip < 0 || sb_v3_dot(out, skin->nodes[i]) > sb_v3_dot(out, skin->nodes[tip])))
            tip = i;
    }
    if (tip < 0)
        return;
    at = sb_v3_madd(skin->nodes[tip], REAL(-w->length / 2), out);
    at = out.x != 0 ? sb_v3(at.x, REAL(across), 0) : sb_v3(REAL(across), at.y, 0);
    if (find_heights(o, at, half, &low, &high) < least_cover || !(high - low < w->heights * (1 - 1e-6)))
        return;
    w->out = out;
    w->half = half;
    w->heights = high - low;
    w->place = sb_v3(at.x, at.y, REAL(0.5 * (low + high)));
}

/* The place of the rim where the organ is thinnest, of such that are alike the most central one. */
static int find_place(work *w)
{
    enum { PLACES = 21 };
    const organ *o = &w->scene;
    w->heights = HUGE_VAL;
    for (int k = 0; k < PLACES; k++)
        for (int end = 0; end < 4; end++) {
            double share = 0.5 + (k % 2 ? 0.5 : -0.5) * (double)((k + 1) / 2) / (PLACES / 2);
            sb_vec3 out = sb_v3(REAL(end == 0 ? -1 : end == 1), REAL(end == 2 ? -1 : end == 3), 0);
            double low = (double)(end < 2 ? o->low.y : o->low.x), high = (double)(end < 2 ? o->high.y : o->high.x);
            try_place(w, out, low + share * (high - low));
        }
    return w->heights < HUGE_VAL ? 0
                                 : organ_complain(o, "the organ", "has no rim that jaws could close at", ORGAN_USAGE);
}

/* Holds what is farthest from the jaws. */
static int hold_far_end(const work *w)
{
    const organ *o = &w->scene;
    sb_real least = SB_REAL_MAX, most = -SB_REAL_MAX, limit;
    sb_error error;
    for (int i = 0; i < o->mesh.node_count; i++) {
        sb_real along = sb_v3_dot(w->out, o->mesh.nodes[i]);
        least = sb_min(least, along);
        most = sb_max(most, along);
    }
    limit = least + REAL(w->set->held) * (most - least);
    for (int i = 0; i < o->mesh.node_count; i++)
        if (sb_v3_dot(w->out, o->mesh.nodes[i]) <= limit && sb_body_hold(o->body, &i, 1, SB_XYZ, &error) != SB_OK)
            return organ_complain_of(o, "the organ", &error, ORGAN_FAILED);
    if (sb_v3_dot(w->out, w->place) - REAL(w->length / 2) <= limit)
        return organ_complain(o, "--held", "would hold what is between the jaws: it needs to be less", ORGAN_USAGE);
    return 0;
}

static sb_vec3 jaw_place(const work *w, int jaw)
{
    double off = 0.5 * w->heights + gap + (double)w->half.z - w->closed;
    return sb_v3_add(w->place, sb_v3_add(w->shift, sb_v3(0, 0, REAL(jaw == 0 ? off : -off))));
}

static int make_scene(work *w)
{
    const settings *s = w->set;
    sb_body_def body = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    int status = find_place(w);
    body.material = sb_material_corotated(REAL(s->young), REAL(s->poisson), REAL(s->density));
    body.gravity = sb_v3(0, 0, 0);
    body.damping_stiffness = REAL(0.01);
    contact.max_contacts = w->point_room = 1 << 15;
    if (!status)
        status = organ_make_body(&w->scene, &body, &contact);
    if (!status)
        status = hold_far_end(w);
    for (int j = 0; j < 2 && !status; j++) {
        sb_tool_def jaw = sb_default_tool_def();
        jaw.shape = SB_TOOL_BOX;
        jaw.half = w->half;
        jaw.radius = REAL(0.75 * (double)w->half.z);
        jaw.friction = REAL(s->mu);
        jaw.pose.position = jaw_place(w, j);
        status = organ_add_tool(&w->scene, &jaw, &w->jaws[j]);
    }
    return status;
}

static int take_memory(work *w)
{
    size_t nodes = (size_t)w->scene.mesh.node_count;
    double squeeze = w->set->squeeze * w->heights / 2 + gap;
    w->room =
        (int)((squeeze + w->set->lift + w->set->way) / w->set->speed / w->set->dt + 2 * hold_time / w->set->dt) + 8;
    for (int c = 0; c < COLUMNS; c++)
        w->columns[c] = (double *)calloc((size_t)w->room, sizeof(double));
    w->milliseconds = (double *)calloc((size_t)w->room, sizeof(double));
    w->gripped = (int *)calloc(nodes, sizeof(int));
    w->gripped_at = (sb_vec3 *)calloc(nodes, sizeof(sb_vec3));
    w->peak_places = (sb_vec3 *)calloc(nodes, sizeof(sb_vec3));
    w->peak_stress = (sb_real *)calloc(nodes, sizeof(sb_real));
    w->points = (sb_contact_point *)calloc((size_t)w->point_room, sizeof *w->points);
    for (int c = 0; c < COLUMNS; c++)
        if (!w->columns[c])
            return organ_complain_memory(&w->scene);
    return w->milliseconds && w->gripped && w->gripped_at && w->peak_places && w->peak_stress && w->points
               ? 0
               : organ_complain_memory(&w->scene);
}

/* ---- readings -------------------------------------------------------------------------------------------------- */

/* What friction of both jaws holds at most (N): mu times the sum of what presses on each sample. */
static double friction_bound(work *w)
{
    int count = sb_contact_points(w->scene.contact, w->points, w->point_room);
    double pressed = 0;
    for (int i = 0; i < count && i < w->point_room; i++)
        pressed += fabs((double)sb_v3_dot(w->points[i].force, w->points[i].normal));
    return w->set->mu * pressed;
}

/* Mean way (m) that the gripped nodes were left behind by the jaws. */
static double slip(const work *w)
{
    double sum = 0;
    for (int k = 0; k < w->gripped_count; k++) {
        sb_vec3 moved = sb_v3_sub(sb_body_positions(w->scene.body)[w->gripped[k]], w->gripped_at[k]);
        sum += (double)sb_v3_dot(w->out, sb_v3_sub(w->shift, moved));
    }
    return w->gripped_count ? sum / w->gripped_count : 0;
}

/* Remembers which nodes the jaws press on now that they have closed. */
static int mark_gripped(work *w)
{
    const organ *o = &w->scene;
    if (sb_contact_pressures(o->contact, o->numbers) != SB_OK)
        return organ_complain_memory(o);
    w->gripped_count = 0;
    for (int i = 0; i < o->mesh.node_count; i++)
        if (o->numbers[i] > 0) {
            w->gripped_at[w->gripped_count] = sb_body_positions(o->body)[i];
            w->gripped[w->gripped_count++] = i;
        }
    return 0;
}

static void keep_peak(work *w)
{
    memcpy(w->peak_places, sb_body_positions(w->scene.body), (size_t)w->scene.mesh.node_count * sizeof(sb_vec3));
    sb_body_nodal_von_mises(w->scene.body, w->peak_stress);
    for (int j = 0; j < 2; j++)
        w->peak_jaws[j] = jaw_place(w, j);
}

static void read_step(work *w)
{
    sb_contact_info info = sb_contact_get_info(w->scene.contact);
    sb_wrench wrench[2];
    sb_vec3 both;
    double row[COLUMNS];
    for (int j = 0; j < 2; j++)
        sb_contact_wrench(w->scene.contact, w->jaws[j], &wrench[j]);
    both = sb_v3_add(wrench[0].force, wrench[1].force);
    row[TIME] = (w->steps + 1) * w->set->dt;
    row[GRIP] = 0.5 * (double)(wrench[0].force.z - wrench[1].force.z);
    row[PULL] = -(double)sb_v3_dot(w->out, both);
    row[LIFT] = -(double)both.z;
    row[BOUND] = friction_bound(w);
    row[SLIP] = 1e3 * slip(w);
    row[STICKING] = info.touching > 0 ? (double)info.sticking / info.touching : 0;
    for (int c = 0; c < COLUMNS; c++)
        w->columns[c][w->steps] = row[c];
    if (row[PULL] > w->peak && !w->slides) {
        w->peak = row[PULL];
        w->peak_bound = row[BOUND];
        keep_peak(w);
    }
    w->slides = w->slides || row[SLIP] > 0.1e3 * w->length;
}

/* ---- the run --------------------------------------------------------------------------------------------------- */

static int step(work *w, const char *words)
{
    int status = 0;
    for (int j = 0; j < 2; j++) {
        sb_pose pose;
        pose.position = jaw_place(w, j);
        pose.rotation = sb_quat_identity();
        sb_contact_move_tool(w->scene.contact, w->jaws[j], &pose);
    }
    status = organ_step(&w->scene, w->set->dt);
    if (status)
        return status;
    read_step(w);
    w->milliseconds[w->steps] = 1e3 * w->scene.seconds;
    progress_show((double)w->steps / w->room, words);
    w->steps++;
    if (w->set->every > 0 && w->steps % w->set->every == 0)
        status = organ_write_frame(&w->scene, w->set->out);
    return status;
}

/* *value goes up by `way` (m) at the jaws' speed. */
static int travel(work *w, double way, sb_vec3 direction, double *closed, const char *words)
{
    int steps = (int)ceil(way / (w->set->speed * w->set->dt)), status = 0;
    sb_vec3 from = w->shift;
    double was = w->closed;
    for (int i = 1; i <= steps && !status; i++) {
        double gone = way * i / steps;
        if (closed)
            *closed = was + gone;
        else
            w->shift = sb_v3_madd(from, REAL(gone), direction);
        status = step(w, words);
    }
    return status;
}

static int rest(work *w, const char *words)
{
    int status = 0;
    for (double t = 0; t < hold_time && !status; t += w->set->dt)
        status = step(w, words);
    return status;
}

/* Outward until the organ has slipped by half a jaw, or has been lost, or the way is at its end. */
static int pull(work *w)
{
    double stride = w->set->speed * w->set->dt;
    int status = 0;
    for (double gone = 0; gone < w->set->way && !status && w->steps < w->room; gone += stride) {
        w->shift = sb_v3_madd(w->shift, REAL(stride), w->out);
        status = step(w, "pulling");
        if (!status && w->columns[SLIP][w->steps - 1] > 0.5e3 * w->length)
            break;
        if (!status && sb_contact_get_info(w->scene.contact).touching == 0)
            break;
    }
    return status;
}

static int run_steps(work *w)
{
    int status = travel(w, w->set->squeeze * w->heights / 2 + gap, sb_v3(0, 0, 0), &w->closed, "closing");
    if (!status)
        status = rest(w, "gripping");
    if (!status)
        status = mark_gripped(w);
    if (!status && w->gripped_count == 0)
        status = organ_complain(&w->scene, "the jaws", "have closed on nothing: take more --squeeze", ORGAN_USAGE);
    if (!status && w->set->lift > 0)
        status = travel(w, w->set->lift, sb_v3(0, 0, 1), NULL, "lifting");
    if (!status)
        status = rest(w, "holding");
    if (!status)
        status = pull(w);
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
    for (int i = 0; i < w->steps; i++)
        for (int c = 0; c < COLUMNS; c++)
            fprintf(out.file, "%.6g%s", w->columns[c][i], c + 1 < COLUMNS ? "," : "\n");
    return sb_output_close(&out, NULL) == SB_OK ? 0 : organ_complain_file(&w->scene, path);
}

static int write_chart(work *w)
{
    static const char *const names[] = {"grip of a jaw", "pull outward", "lift", "mu times what both press"};
    static const int curves[] = {GRIP, PULL, LIFT, BOUND};
    char path[ORGAN_PATH + 32];
    plot p;
    plot_panel *panel;
    plot_begin(&p, "Two jaws grip, lift and pull until it slips");
    panel = plot_add_panel(&p, "forces", "time (s)", "force (N)");
    for (int c = 0; c < 4; c++)
        plot_add_curve(panel, names[c], w->columns[TIME], w->columns[curves[c]], w->steps);
    panel = plot_add_panel(&p, "how far it was left behind", "time (s)", "slip (mm)");
    plot_add_curve(panel, "slip", w->columns[TIME], w->columns[SLIP], w->steps);
    panel = plot_add_panel(&p, "points that stick", "time (s)", "share");
    plot_add_curve(panel, "sticking", w->columns[TIME], w->columns[STICKING], w->steps);
    snprintf(path, sizeof path, "%s.svg", w->set->out);
    return plot_save_svg(&p, path) ? 0 : organ_complain_file(&w->scene, path);
}

/* Upper end of the colours: 98 % of the skin is below it. */
static double colour_limit(const work *w)
{
    int count = w->scene.boundary.surface.node_count;
    double *values = (double *)malloc((size_t)count * sizeof *values), limit = 0;
    for (int i = 0; values && i < count; i++)
        values[i] = (double)w->peak_stress[w->scene.boundary.nodes[i]];
    if (values) {
        organ_median(values, count);
        limit = values[(size_t)count * 98 / 100];
    }
    free(values);
    return limit > 0 ? limit : 1;
}

static int draw_picture(work *w)
{
    const int width = 1280, height = 960;
    double limit = colour_limit(w), highest = 0;
    char path[ORGAN_PATH + 32], title[128], details[160];
    picture p;
    for (int i = 0; i < w->scene.boundary.surface.node_count; i++)
        highest = fmax(highest, (double)w->peak_stress[w->scene.boundary.nodes[i]]);
    picture_begin(&p, width, height);
    organ_draw(&w->scene, &p, w->peak_places, w->peak_stress, limit);
    for (int j = 0; j < 2; j++)
        picture_add_block(&p, w->peak_jaws[j], sb_quat_identity(), w->half, picture_web(0x9aa5b1));
    picture_render(&p, 28, 24);
    picture_colour_bar(&p, "von Mises stress", "kPa", 0, 1e-3 * limit, 1e-3 * highest);
    picture_length_bar(&p);
    snprintf(title, sizeof title, "Gripped with %.2f N, pulled with %.2f N", w->columns[GRIP][w->steps - 1], w->peak);
    snprintf(details, sizeof details, "%d %s, E %.4g kPa, nu %.3g, mu %.3g", w->scene.mesh.element_count,
             sb_element_name(w->scene.mesh.element_type), 1e-3 * w->set->young, w->set->poisson, w->set->mu);
    picture_text(&p, 0.06 * width, 0.075 * height, 22, PICTURE_LEFT, picture_ink(), title);
    picture_text(&p, 0.06 * width, 0.115 * height, 14, PICTURE_LEFT, picture_ink(), details);
    snprintf(path, sizeof path, "%s.png", w->set->out);
    return organ_save_picture(&w->scene, &p, path);
}

static int write_frames(work *w)
{
    return w->scene.frames ? organ_write_series(&w->scene, w->set->out, w->set->every * w->set->dt) : 0;
}

static int print_summary(work *w)
{
    int last = w->steps - 1,
        slipped = w->columns[SLIP][last] > 0.5e3 * w->length || sb_contact_get_info(w->scene.contact).touching == 0;
    printf("organ       %s: %d nodes, %d %s; %.1f mm thick between jaws of %.0f x %.0f mm\n",
           w->set->organ ? w->set->organ : "a flap", w->scene.mesh.node_count, w->scene.mesh.element_count,
           sb_element_name(w->scene.mesh.element_type), 1e3 * w->heights, 1e3 * w->length, 1e3 * w->width);
    printf("grip        %d nodes between the jaws, pulled over %.1f mm%s\n", w->gripped_count,
           1e3 * (double)sb_v3_dot(w->out, w->shift), slipped ? ": it slipped out" : ": it held; take a longer --way");
    printf("written     %s.csv, %s.svg, %s.png", w->set->out, w->set->out, w->set->out);
    if (w->scene.frames)
        printf(", %s_0000.vtk to _%04d.vtk; ParaView opens %s.vtk.series", w->set->out, w->scene.frames - 1,
               w->set->out);
    printf("\nslipped=%d pull_out_N=%.4g mu_N=%.4g ratio=%.3f steps=%d median_ms=%.2f\n", slipped, w->peak,
           w->peak_bound, w->peak_bound > 0 ? w->peak / w->peak_bound : 0, w->steps,
           organ_median(w->milliseconds, w->steps));
    return 0;
}

static void release(work *w)
{
    organ_free(&w->scene);
    for (int c = 0; c < COLUMNS; c++)
        free(w->columns[c]);
    free(w->milliseconds);
    free(w->gripped);
    free(w->gripped_at);
    free(w->peak_places);
    free(w->peak_stress);
    free(w->points);
}

static int run(const settings *set)
{
    static int (*const stages[])(work *) = {make_mesh,   choose_jaws, make_scene,   take_memory,  run_steps,
                                            write_table, write_chart, draw_picture, write_frames, print_summary};
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
    s.mu = 0.3;
    s.young = 20000;
    s.poisson = 0.4;
    s.density = 1000;
    s.speed = 0.02;
    s.squeeze = 0.4;
    s.lift = 0.01;
    s.way = 0.06;
    s.held = 0.15;
    s.dt = 0.01;
    s.thickness = 0.008;
    s.flap[0] = 0.06, s.flap[1] = 0.02, s.flap[2] = 0.006;
    s.cells = 6;
    return s;
}

enum { OPTION_COUNT = 22 };
static void list_options(settings *s, option options[OPTION_COUNT])
{
    const option all[OPTION_COUNT] = {
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &s->out, 0, 0, "files are NAME.csv, NAME.svg, NAME.png"},
        {"--scale", "X", OPTION_NUMBER, NULL, &s->scale, NULL, 1e-9, 1e9,
         "multiplies the file's lengths; 0.001 for millimetres"},
        {"--mu", "MU", OPTION_NUMBER, NULL, &s->mu, NULL, 0, 100, "friction of the jaws"},
        {"--young", "PA", OPTION_NUMBER, NULL, &s->young, NULL, 1, 1e9, "Young's modulus (Pa)"},
        {"--poisson", "NU", OPTION_NUMBER, NULL, &s->poisson, NULL, 0, 0.49, "Poisson's ratio"},
        {"--density", "RHO", OPTION_NUMBER, NULL, &s->density, NULL, 1, 1e5, "density (kg/m^3)"},
        {"--speed", "V", OPTION_NUMBER, NULL, &s->speed, NULL, 1e-4, 0.1, "speed of the jaws (m/s)"},
        {"--squeeze", "SHARE", OPTION_NUMBER, NULL, &s->squeeze, NULL, 0.01, 0.8,
         "share of the thickness by which they close"},
        {"--lift", "M", OPTION_NUMBER, NULL, &s->lift, NULL, 0, 0.2, "how far they lift (m)"},
        {"--way", "M", OPTION_NUMBER, NULL, &s->way, NULL, 1e-3, 1, "how far they pull at most (m)"},
        {"--held", "SHARE", OPTION_NUMBER, NULL, &s->held, NULL, 0.001, 0.9,
         "share of the organ's length that is held"},
        {"--length", "M", OPTION_NUMBER, NULL, &s->length, NULL, 0, 1,
         "of a jaw along the pull (m); 0: as suits the organ"},
        {"--width", "M", OPTION_NUMBER, NULL, &s->width, NULL, 0, 1, "of a jaw across it (m); 0: likewise"},
        {"--thickness", "M", OPTION_NUMBER, NULL, &s->thickness, NULL, 1e-4, 1, "of a jaw (m)"},
        {"--dt", "S", OPTION_NUMBER, NULL, &s->dt, NULL, 1e-4, 0.05, "time of a step (s)"},
        {"--cells", "N", OPTION_INTEGER, &s->cells, NULL, NULL, 2, 40, "of the flap across its width"},
        {"--flap-length", "M", OPTION_NUMBER, NULL, &s->flap[0], NULL, 1e-3, 1, "of the flap that is made (m)"},
        {"--flap-width", "M", OPTION_NUMBER, NULL, &s->flap[1], NULL, 1e-3, 1, "likewise"},
        {"--flap-thickness", "M", OPTION_NUMBER, NULL, &s->flap[2], NULL, 1e-3, 1, "likewise"},
        {"--every", "K", OPTION_INTEGER, &s->every, NULL, NULL, 0, 1e6,
         "write every K-th step as NAME_0000.vtk and so on; 0 (default): none"},
        {"--help", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, "this text"},
        {"-h", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, NULL},
    };
    memcpy(options, all, sizeof all);
}

static int check_settings(const settings *s)
{
    if (!organ_check_name(program_name, "-o", s->out))
        return 0;
    return 1;
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
        printf("usage: grasp [ORGAN] [OPTIONS]\n\n"
               "Two jaws grip an organ, lift it and pull until it slips. ORGAN: a volume mesh in metres (VTK, VTU,\n"
               "gmsh, Medit or TetGen); without it a flap is made. The thinnest place of its rim to -x, x, -y or y\n"
               "is gripped from above and below.\n\n");
        options_print(options, OPTION_COUNT);
        printf("\nThe last line: whether it slipped, the largest pull before it had slipped by a tenth of a jaw, what\n"
               "friction held then at most (mu times all that pressed), their ratio (1 where the jaws lie flat, less "
               "on a\n"
               "round rim, which slides out by itself), and the median of a step's time.\n");
        return 0;
    }
    return check_settings(&s) ? run(&s) : ORGAN_USAGE;
}

int main(int argc, char **argv) { return finish(program_name, program(argc, argv), ORGAN_USAGE); }
