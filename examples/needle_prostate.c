/* needle_prostate: a flexible needle goes into a prostate phantom, is turned, goes on, and is drawn out again.
 *
 *     needle_prostate [--mesh FILE | --anatomy [--lesion]] [--tip bevel|symmetric] [--seconds S] [--csv FILE] [-o
 * PREFIX]
 *
 * The needle is fed at 1 cm/s through a template that stands before the block; steps of 20 ms. A bevelled tip curves
 * upwards until the base is turned by half a turn, then downwards. Written are PREFIX_0000.vtk and so on (tissue),
 * those with _needle in their names (the needle), lists of both for ParaView (PREFIX.vtk.series,
 * PREFIX_needle.vtk.series), PREFIX.svg (forces, tip, angles of the mesh) and PREFIX.png (the phantom cut open where
 * the needle is deepest). Exit status: 0, 2 wrong usage or a file that cannot be read or written, 3 no memory or a
 * step failed. */
#include "system.h"

#if defined(_OPENMP)
#define SB_USE_OPENMP
#endif
#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#include "softbody.h"

#include "needle.h"

#include "options.h"
#include "phantom.h"
#include "picture.h"
#include "plot.h"

#define REAL(x) ((sb_real)(x))

enum { EXIT_USAGE = 2, EXIT_SOLVE = 3, PATH_SIZE = 1024, FRAME_STEPS = 25 };
static const double STEP = 0.02, SPEED = 0.01, BEVEL = 7; /* s, m/s, 1/m */

typedef struct settings {
    const char *mesh, *tip, *csv, *prefix;
    double seconds;
    int anatomy, lesion, help;
} settings;

/* Curves of the chart: one value per step each. */
enum { TIME, TIP_X, TIP_Y, TIP_Z, FORCE_X, FORCE_Y, FORCE_Z, MIN_ANGLE, MAX_ANGLE, MILLISECONDS, CURVES };

typedef struct work {
    const settings *set;
    phantom body;
    int steps, done, cycles, frames;
    double *curves[CURVES]; /* [steps] */
    double deepest;         /* m fed at the end of the insertions */
    int consistent, blocked;
    double worst_quality;
    sb_output csv; /* csv.file is NULL: none is open */
} work;

/* The tissue as it is now, for files and pictures. */
typedef struct tissue_copy {
    sb_mesh mesh;          /* deformed */
    sb_vec3 *displacement; /* [mesh.node_count] m */
    sb_real *quality;      /* [mesh.element_count] of the tets in the material, as ndl_remesh_quality has it */
} tissue_copy;

/* ---- messages -------------------------------------------------------------------------------------------------- */

static int complain(const sb_error *error)
{
    progress_end();
    if (error->file[0] && error->line > 0)
        fprintf(stderr, "needle_prostate: %s:%d: %s\n", error->file, error->line, error->message);
    else if (error->file[0])
        fprintf(stderr, "needle_prostate: %s: %s\n", error->file, error->message);
    else
        fprintf(stderr, "needle_prostate: %s\n", error->message);
    return error->result == SB_ERROR_MEMORY ? EXIT_SOLVE : EXIT_USAGE;
}

static int complain_memory(void)
{
    progress_end();
    fputs("needle_prostate: not enough memory\n", stderr);
    return EXIT_SOLVE;
}

static int complain_file(const char *path)
{
    progress_end();
    fprintf(stderr, "needle_prostate: %s cannot be written\n", path);
    return EXIT_USAGE;
}

/* PREFIX and what follows it. */
static void name_file(const work *w, const char *ending, char path[PATH_SIZE])
{
    snprintf(path, PATH_SIZE, "%s%s", w->set->prefix, ending);
}

/* ---- the scene ------------------------------------------------------------------------------------------------- */

static int make_mesh(work *w)
{
    sb_error error;
    sb_result result = w->set->mesh      ? sb_mesh_load(&w->body.mesh, w->set->mesh, NULL, &error)
                       : w->set->anatomy ? phantom_make_anatomy(&w->body, &error)
                                         : phantom_make_mesh(&w->body.mesh, &error);
    if (result == SB_OK)
        result = phantom_survey(&w->body, &error);
    if (result == SB_OK && w->set->lesion)
        result = phantom_add_lesion(&w->body, &error);
    if (result == SB_OK)
        return 0;
    if (w->set->mesh && !error.file[0])
        snprintf(error.file, sizeof error.file, "%.200s", w->set->mesh);
    return complain(&error);
}

static int count_lesion(const phantom *p)
{
    int count = 0;
    for (int k = 0; k < p->lesion.body_mesh.element_count; k++)
        count += p->lesion.body_mesh.regions[k] == PHANTOM_LESION;
    return count;
}

static int make_scene(work *w)
{
    sb_body_def def = phantom_default_body_def();
    sb_error error;
    def.clock = seconds_now;
#if defined(SB_USE_OPENMP)
    def.jobs = sb_jobs_openmp();
#endif
    if (phantom_make_tissue(&w->body, &def, &error) != SB_OK ||
        phantom_make_needle(&w->body, REAL(strcmp(w->set->tip, "bevel") == 0 ? BEVEL : 0), sb_v3(0, 0, 0), &error) !=
            SB_OK)
        return complain(&error);
    printf("tissue         %d nodes, %d tets, %.0f x %.0f x %.0f mm%s\n", w->body.mesh.node_count,
           w->body.mesh.element_count, 1e3 * (double)(w->body.high.x - w->body.low.x),
           1e3 * (double)(w->body.high.y - w->body.low.y), 1e3 * (double)(w->body.high.z - w->body.low.z),
           w->body.prostate >= 0 ? ", with a prostate" : "");
    if (w->body.has_lesion)
        printf("lesion         in %d tets, %d of them mixed\n", count_lesion(&w->body), w->body.lesion.mixed_count);
    return 0;
}

/* The needle goes in and out as often as needed to fill the time without going further than three quarters through. */
static int plan_run(work *w)
{
    double through = 0.75 * (double)(w->body.high.x - w->body.low.x) + (double)w->body.free_length;
    double most = through / (0.5 * SPEED);
    w->cycles = (int)ceil(w->set->seconds / most);
    w->steps = (int)(w->set->seconds / STEP + 0.5);
    w->worst_quality = 1;
    for (int c = 0; c < CURVES; c++) {
        w->curves[c] = (double *)malloc((size_t)w->steps * sizeof *w->curves[c]);
        if (!w->curves[c])
            return complain_memory();
    }
    if (!w->set->csv)
        return 0;
    if (sb_output_open(&w->csv, w->set->csv, NULL) != SB_OK)
        return complain_file(w->set->csv);
    fputs("t,tip_x,tip_y,tip_z,base_fx,base_fy,base_fz,base_torque,static,dynamic,trials,iterations,quality,"
          "min_dihedral,max_dihedral,ms\n",
          w->csv.file);
    return 0;
}

/* What the needle is to do at a time: in, half a turn, further in, half a turn back, out. */
static ndl_command command_at(work *w, double time)
{
    const double pi = 3.14159265358979, span = w->set->seconds / w->cycles;
    const double at = time / span - floor(time / span), fed = (double)ndl_needle_fed(w->body.needle);
    ndl_command command;
    memset(&command, 0, sizeof command);
    if (at < 0.3 || (at >= 0.35 && at < 0.55)) {
        command.insertion = REAL(SPEED);
        w->deepest = fed + SPEED * STEP;
    } else if (at < 0.6) {
        command.twist = REAL((at < 0.35 ? pi : -pi) / (0.05 * span));
    } else if (fed > -0.002) {
        command.insertion = REAL(-(w->deepest + 0.004) / (0.35 * span));
    }
    return command;
}

/* ---- files ----------------------------------------------------------------------------------------------------- */

static void free_copy(tissue_copy *copy)
{
    sb_mesh_free(&copy->mesh);
    free(copy->displacement);
    free(copy->quality);
    memset(copy, 0, sizeof *copy);
}

/* Moves the copy's nodes to where they are; number: of each node of the body in the copy, or -1. */
static void deform_copy(const sb_body *body, const int *number, tissue_copy *copy)
{
    for (int i = 0; i < sb_body_node_count(body); i++)
        if (number[i] >= 0) {
            copy->displacement[number[i]] = sb_body_displacements(body)[i];
            copy->mesh.nodes[number[i]] = sb_body_positions(body)[i];
        }
}

/* The body's mesh; of one with a lesion, whose elements it has once for each region, that from which it was made. */
static sb_result copy_mesh(const work *w, sb_mesh *mesh, int *number)
{
    if (!w->body.has_lesion)
        return sb_body_get_mesh(w->body.tissue, NULL, mesh, number, NULL, NULL);
    for (int i = 0; i < sb_body_node_count(w->body.tissue); i++)
        number[i] = i;
    return sb_mesh_copy(&w->body.mesh, NULL, mesh, NULL);
}

/* 0: no memory; then nothing is to be released. */
static int copy_tissue(const work *w, tissue_copy *copy)
{
    const sb_body *body = w->body.tissue;
    int *number = (int *)malloc((size_t)sb_body_node_count(body) * sizeof *number), good;
    memset(copy, 0, sizeof *copy);
    good = number && copy_mesh(w, &copy->mesh, number) == SB_OK;
    if (good) {
        copy->displacement = (sb_vec3 *)malloc((size_t)copy->mesh.node_count * sizeof *copy->displacement);
        copy->quality = (sb_real *)malloc((size_t)copy->mesh.element_count * sizeof *copy->quality);
        good = copy->displacement && copy->quality;
    }
    if (good) { /* the mean ratio is the needles' quality to the power of 2/3 */
        for (int e = 0; e < copy->mesh.element_count; e++)
            copy->quality[e] = REAL(pow(fmax(0, (double)sb_mesh_element_quality(&copy->mesh, e)), 1.5));
        deform_copy(body, number, copy);
    } else {
        free_copy(copy);
    }
    free(number);
    return good;
}

static int write_tissue(work *w, int frame)
{
    char path[PATH_SIZE], ending[32];
    sb_field fields[2] = {{"displacement", SB_FIELD_NODES, 3, NULL}, {"quality", SB_FIELD_ELEMENTS, 1, NULL}};
    tissue_copy copy;
    sb_error error;
    sb_result result;
    if (!copy_tissue(w, &copy))
        return complain_memory();
    fields[0].values = &copy.displacement[0].x;
    fields[1].values = copy.quality;
    snprintf(ending, sizeof ending, "_%04d.vtk", frame);
    name_file(w, ending, path);
    result = sb_mesh_save_vtk_binary(path, &copy.mesh, fields, 2, &error);
    free_copy(&copy);
    return result == SB_OK ? 0 : complain(&error);
}

/* The needle as a line, with what the tissue does to its nodes: 0 free, 1 sticks, 2 slips inwards, 3 outwards. */
static int write_needle(work *w, int frame)
{
    const ndl_needle *needle = w->body.needle;
    const ndl_rod *rod = ndl_needle_rod(needle);
    int n = ndl_rod_node_count(rod);
    char path[PATH_SIZE], ending[32];
    sb_output out;
    snprintf(ending, sizeof ending, "_needle_%04d.vtk", frame);
    name_file(w, ending, path);
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return complain_file(path);
    fprintf(out.file, "# vtk DataFile Version 3.0\nneedle\nASCII\nDATASET POLYDATA\nPOINTS %d double\n", n);
    for (int i = 0; i < n; i++) {
        sb_vec3 x = ndl_rod_positions(rod)[i];
        fprintf(out.file, "%.9g %.9g %.9g\n", (double)x.x, (double)x.y, (double)x.z);
    }
    fprintf(out.file, "LINES 1 %d\n%d", n + 1, n);
    for (int i = 0; i < n; i++)
        fprintf(out.file, " %d", i);
    fprintf(out.file, "\nPOINT_DATA %d\nSCALARS contact int 1\nLOOKUP_TABLE default\n", n);
    for (int i = 0; i < n; i++)
        fprintf(out.file, "%d\n", (int)ndl_needle_contact(needle, i));
    fprintf(out.file, "VECTORS force double\n");
    for (int i = 0; i < n; i++) {
        sb_vec3 f = ndl_needle_contact_force(needle, i);
        fprintf(out.file, "%.9g %.9g %.9g\n", (double)f.x, (double)f.y, (double)f.z);
    }
    return sb_output_close(&out, NULL) == SB_OK ? 0 : complain_file(path);
}

static int write_frame(work *w)
{
    int status = write_tissue(w, w->frames);
    if (!status)
        status = write_needle(w, w->frames);
    w->frames++;
    return status;
}

/* ParaView's list of the files with their times; `kind` is "" or "_needle". */
static int write_series(const work *w, const char *kind)
{
    char path[PATH_SIZE], ending[32];
    const char *name = w->set->prefix;
    sb_output out;
    for (const char *c = name; *c; c++)
        if (*c == '/' || *c == '\\')
            name = c + 1;
    snprintf(ending, sizeof ending, "%s.vtk.series", kind);
    name_file(w, ending, path);
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return complain_file(path);
    fprintf(out.file, "{\"file-series-version\": \"1.0\", \"files\": [\n");
    for (int i = 0; i < w->frames; i++)
        fprintf(out.file, "  {\"name\": \"%s%s_%04d.vtk\", \"time\": %.6g}%s\n", name, kind, i, i * FRAME_STEPS * STEP,
                i + 1 < w->frames ? "," : "");
    fprintf(out.file, "]}\n");
    return sb_output_close(&out, NULL) == SB_OK ? 0 : complain_file(path);
}

static int write_chart(const work *w)
{
    static plot p;
    char path[PATH_SIZE];
    plot_panel *force, *tip, *angles;
    plot_begin(&p, "A flexible needle in a prostate phantom");
    force = plot_add_panel(&p, "force on the base of the needle", "time (s)", "force (N)");
    plot_add_curve(force, "along (x)", w->curves[TIME], w->curves[FORCE_X], w->done);
    plot_add_curve(force, "aside (y)", w->curves[TIME], w->curves[FORCE_Y], w->done);
    plot_add_curve(force, "upwards (z)", w->curves[TIME], w->curves[FORCE_Z], w->done);
    tip = plot_add_panel(&p, "way of the tip", "x (mm)", "y, z from the start (mm)");
    plot_add_curve(tip, "y", w->curves[TIP_X], w->curves[TIP_Y], w->done);
    plot_add_curve(tip, "z", w->curves[TIP_X], w->curves[TIP_Z], w->done);
    angles = plot_add_panel(&p, "dihedral angles of the mesh", "time (s)", "angle (degrees)");
    plot_add_curve(angles, "smallest", w->curves[TIME], w->curves[MIN_ANGLE], w->done);
    plot_add_curve(angles, "largest", w->curves[TIME], w->curves[MAX_ANGLE], w->done);
    name_file(w, ".svg", path);
    return plot_save_svg(&p, path) ? 0 : complain_file(path);
}

/* ---- picture --------------------------------------------------------------------------------------------------- */

static void draw_needle(const work *w, picture *p)
{
    const ndl_rod *rod = ndl_needle_rod(w->body.needle);
    const sb_vec3 *x = ndl_rod_positions(rod);
    for (int i = 0; i + 1 < ndl_rod_node_count(rod); i++)
        picture_add_capsule(p, x[i], x[i + 1], 0.0008, picture_web(0x2f6f9f)); /* twice as thick as it is */
}

/* What is drawn by itself: tissue coloured by displacement, the prostate and the lesion each in one colour. */
typedef enum drawn_part { DRAW_TISSUE = 0, DRAW_PROSTATE = 1, DRAW_LESION = 2, DRAW_COUNT = 3 } drawn_part;

static const unsigned part_colours[DRAW_COUNT] = {0, 0x8fb8b0, 0xb5533c};

/* Of each element the part that it is drawn with: the lesion's are those that have more than half of it. Its surface is
 * drawn as the mesh has it. The caller's to free; NULL: no memory. */
static unsigned char *list_parts(const work *w, const tissue_copy *copy)
{
    const sb_mixture *lesion = &w->body.lesion;
    unsigned char *parts = (unsigned char *)malloc((size_t)copy->mesh.element_count + 1);
    for (int e = 0; parts && e < copy->mesh.element_count; e++)
        parts[e] = copy->mesh.regions[e] == w->body.prostate ? DRAW_PROSTATE : DRAW_TISSUE;
    for (int k = 0; parts && w->body.has_lesion && k < lesion->body_mesh.element_count; k++)
        if (lesion->body_mesh.regions[k] == PHANTOM_LESION && lesion->shares[k] > REAL(0.5))
            parts[lesion->elements[k]] = DRAW_LESION;
    return parts;
}

/* The tets of a part, as a mesh that borrows the nodes; its elements are the caller's to free. */
static sb_mesh part_of(const tissue_copy *copy, const unsigned char *parts, drawn_part which)
{
    sb_mesh part = copy->mesh;
    part.regions = NULL;
    part.elements = (int *)malloc(4 * (size_t)(part.element_count + 1) * sizeof *part.elements);
    part.element_count = 0;
    for (int e = 0; part.elements && e < copy->mesh.element_count; e++)
        if (parts[e] == which)
            memcpy(part.elements + 4 * (size_t)part.element_count++, copy->mesh.elements + 4 * (size_t)e,
                   4 * sizeof *part.elements);
    return part;
}

/* Surface and section of a part, of the tissue coloured by displacement (mm). 0: no memory. */
static int draw_part(picture *p, const tissue_copy *copy, const unsigned char *parts, drawn_part which, double limit,
                     picture_plane plane)
{
    sb_mesh part = part_of(copy, parts, which);
    size_t nodes = (size_t)part.node_count;
    sb_real *moved = (sb_real *)malloc(2 * (nodes + 1) * sizeof *moved), *on_skin = moved + nodes; /* mm */
    sb_boundary boundary;
    int first = p->count, drawn = part.elements && moved && part.element_count == 0;
    for (size_t i = 0; moved && i < nodes; i++)
        moved[i] = 1000 * sb_v3_norm(copy->displacement[i]);
    if (part.elements && moved && part.element_count && sb_mesh_boundary(&part, 1, NULL, &boundary, NULL) == SB_OK) {
        for (int i = 0; i < boundary.surface.node_count; i++)
            on_skin[i] = moved[boundary.nodes[i]];
        picture_add_surface(p, &boundary.surface, on_skin, 0, limit);
        picture_clip(p, first, plane);
        picture_add_section(p, &part, moved, 0, limit, plane);
        sb_boundary_free(&boundary);
        drawn = 1;
    }
    for (int i = first; i < p->count && which != DRAW_TISSUE; i++) {
        p->triangles[i].is_plain = 1;
        p->triangles[i].colour = picture_web(part_colours[which]);
    }
    free(moved);
    free(part.elements);
    return drawn;
}

/* All of the tissue, cut open; 0: no memory. */
static int draw_tissue(const work *w, picture *p, const tissue_copy *copy, double limit, picture_plane plane)
{
    unsigned char *parts = list_parts(w, copy);
    int good = parts != NULL;
    for (int k = 0; k < DRAW_COUNT && good; k++)
        good = draw_part(p, copy, parts, (drawn_part)k, limit, plane);
    free(parts);
    return good;
}

/* Which colour is what, below the title. */
static void draw_legend(const work *w, picture *p)
{
    static const char *const names[DRAW_COUNT] = {"", "prostate", "lesion"};
    double x = 0.06 * p->width, y = 0.15 * p->height;
    for (int k = DRAW_PROSTATE; k < DRAW_COUNT; k++) {
        if (k == DRAW_PROSTATE ? w->body.prostate < 0 : !w->body.has_lesion)
            continue;
        picture_box(p, x, y - 12, x + 12, y, picture_web(part_colours[k]));
        picture_text(p, x + 20, y, 14, PICTURE_LEFT, picture_ink(), names[k]);
        x += 40 + picture_text_width(names[k], 14);
    }
}

/* Where the tissue is cut open: upright, along the needle's base and tip, just behind all of it. */
static picture_plane plane_behind(const ndl_needle *needle)
{
    const ndl_rod *rod = ndl_needle_rod(needle);
    const sb_vec3 *x = ndl_rod_positions(rod);
    sb_vec3 along = sb_v3_sub(ndl_needle_tip(needle).position, x[0]);
    picture_plane plane;
    plane.normal = picture_v(-(double)along.y, (double)along.x, 0);
    if (along.x < 0)
        plane.normal = picture_madd(picture_v(0, 0, 0), -1, plane.normal);
    if (picture_dot(plane.normal, plane.normal) == 0) /* an upright needle */
        plane.normal.y = 1;
    plane.normal = picture_unit(plane.normal);
    plane.offset = picture_dot(plane.normal, picture_from(x[0]));
    for (int i = 1; i < ndl_rod_node_count(rod); i++)
        plane.offset = fmax(plane.offset, picture_dot(plane.normal, picture_from(x[i])));
    return plane;
}

/* The phantom without what lies before the needle. */
static int draw_picture(work *w)
{
    const int width = 1280, height = 960;
    char path[PATH_SIZE], details[160];
    tissue_copy copy;
    picture p;
    picture_plane plane = plane_behind(w->body.needle);
    sb_real most = 0;
    double limit;
    int good;
    if (!copy_tissue(w, &copy))
        return complain_memory();
    for (int k = 0; k < 4 * copy.mesh.element_count; k++)
        most = sb_max(most, 1000 * sb_v3_norm(copy.displacement[copy.mesh.elements[k]]));
    limit = most > 0 ? ceil((double)most) : 1;
    picture_begin(&p, width, height);
    good = draw_tissue(w, &p, &copy, limit, plane);
    free_copy(&copy);
    draw_needle(w, &p);
    picture_render(&p, 14, 24);
    picture_colour_bar(&p, "displacement", "mm", 0, limit, (double)most);
    picture_length_bar(&p);
    picture_text(&p, 0.06 * width, 0.075 * height, 22, PICTURE_LEFT, picture_ink(), "A needle in a prostate phantom");
    snprintf(details, sizeof details, "%s tip, %.0f mm deep, cut open at the needle", w->set->tip,
             1e3 * (double)ndl_needle_depth(w->body.needle));
    picture_text(&p, 0.06 * width, 0.115 * height, 14, PICTURE_LEFT, picture_ink(), details);
    draw_legend(w, &p);
    name_file(w, ".png", path);
    good = good ? picture_save_png(&p, path) : PICTURE_NO_MEMORY;
    picture_end(&p);
    return good == PICTURE_OK ? 0 : good == PICTURE_NO_MEMORY ? complain_memory() : complain_file(path);
}

/* ---- the run --------------------------------------------------------------------------------------------------- */

/* Worst quality of the tets in the material, and their angles (degrees). */
static void look_at_mesh(const work *w, sb_real *quality, sb_real *smallest, sb_real *largest)
{
    const ndl_remesh *remesh = ndl_needle_remesh(w->body.needle);
    if (remesh) {
        ndl_remesh_quality(remesh, quality, smallest, largest);
        return;
    }
    *quality = 1;
    for (int e = 0; e < w->body.mesh.element_count; e++)
        *quality = REAL(fmin((double)*quality, (double)sb_mesh_element_quality(&w->body.mesh, e)));
    *quality = REAL(pow((double)*quality, 1.5)); /* as in copies */
    sb_mesh_dihedral_range(&w->body.mesh, smallest, largest);
}

static void note_step(work *w, const ndl_step_info *info)
{
    const ndl_needle *needle = w->body.needle;
    sb_vec3 force, torque, tip = ndl_needle_tip(needle).position;
    sb_real quality, smallest, largest;
    double values[CURVES];
    ndl_needle_base_wrench(needle, &force, &torque);
    look_at_mesh(w, &quality, &smallest, &largest);
    values[TIME] = (w->done + 1) * STEP;
    values[TIP_X] = 1e3 * (double)tip.x;
    values[TIP_Y] = 1e3 * (double)(tip.y - w->body.target.y);
    values[TIP_Z] = 1e3 * (double)(tip.z - w->body.target.z);
    values[FORCE_X] = (double)force.x, values[FORCE_Y] = (double)force.y, values[FORCE_Z] = (double)force.z;
    values[MIN_ANGLE] = (double)smallest, values[MAX_ANGLE] = (double)largest;
    values[MILLISECONDS] = 1e3 * info->seconds_total;
    for (int c = 0; c < CURVES; c++)
        w->curves[c][w->done] = values[c];
    w->consistent += info->consistent;
    w->blocked += info->blocked;
    w->worst_quality = fmin(w->worst_quality, (double)quality);
    if (w->csv.file)
        fprintf(w->csv.file, "%.6g,%.9g,%.9g,%.9g,%.6g,%.6g,%.6g,%.6g,%d,%d,%d,%d,%.5g,%.5g,%.5g,%.4g\n", values[TIME],
                (double)tip.x, (double)tip.y, (double)tip.z, values[FORCE_X], values[FORCE_Y], values[FORCE_Z],
                (double)torque.x, info->static_nodes, info->dynamic_nodes, info->trials, info->iterations,
                (double)quality, values[MIN_ANGLE], values[MAX_ANGLE], values[MILLISECONDS]);
}

static int make_step(work *w)
{
    ndl_command command = command_at(w, w->done * STEP);
    ndl_step_info info;
    sb_error error;
    char words[64];
    if (ndl_step(w->body.tissue, &w->body.needle, 1, REAL(STEP), &command, &info, &error) != SB_OK) {
        progress_end();
        fprintf(stderr, "needle_prostate: step %d: %s\n", w->done + 1, error.message);
        return EXIT_SOLVE;
    }
    note_step(w, &info);
    w->done++;
    snprintf(words, sizeof words, "step %d of %d, %.0f mm deep, %.1f ms", w->done, w->steps,
             1e3 * (double)ndl_needle_depth(w->body.needle), 1e3 * info.seconds_total);
    progress_show((double)w->done / w->steps, words);
    return 0;
}

static int run_steps(work *w)
{
    int picture_step = (int)(0.55 * w->steps / w->cycles), status = write_frame(w);
    while (w->done < w->steps && !status) {
        status = make_step(w);
        if (!status && w->done % FRAME_STEPS == 0)
            status = write_frame(w);
        if (!status && w->done == (picture_step > 0 ? picture_step : 1))
            status = draw_picture(w);
    }
    progress_end();
    return status;
}

static int write_lists(work *w)
{
    int status = write_series(w, "");
    if (!status)
        status = write_series(w, "_needle");
    return status ? status : write_chart(w);
}

static int close_csv(work *w)
{
    return !w->csv.file || sb_output_close(&w->csv, NULL) == SB_OK ? 0 : complain_file(w->set->csv);
}

static int compare_numbers(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static int print_summary(work *w)
{
    double *ms = w->curves[MILLISECONDS];
    const ndl_remesh *remesh = ndl_needle_remesh(w->body.needle);
    qsort(ms, (size_t)w->done, sizeof *ms, compare_numbers);
    printf("written        %s_0000.vtk to _%04d.vtk and %s_needle_...; ParaView opens %s.vtk.series\n", w->set->prefix,
           w->frames - 1, w->set->prefix, w->set->prefix);
    printf("chart, picture %s.svg, %s.png\n", w->set->prefix, w->set->prefix);
    if (w->blocked > 0)
        fprintf(stderr, "needle_prostate: warning: in %d steps the tip could not follow: no sound tets were found\n",
                w->blocked);
    printf("steps=%d median_ms=%.3f p99_ms=%.3f consistent=%.2f%% quality=%.4f topology=%s\n", w->done, ms[w->done / 2],
           ms[w->done * 99 / 100], 100.0 * w->consistent / w->done, w->worst_quality,
           !remesh                          ? "kept"
           : ndl_remesh_is_original(remesh) ? "restored"
                                            : "changed");
    return 0;
}

static void release(work *w)
{
    close_csv(w);
    phantom_free(&w->body);
    for (int c = 0; c < CURVES; c++)
        free(w->curves[c]);
}

static int run(const settings *set)
{
    static int (*const stages[])(work *) = {make_mesh,   make_scene, plan_run,     run_steps,
                                            write_lists, close_csv,  print_summary};
    work w;
    int status = 0;
    memset(&w, 0, sizeof w);
    w.set = set;
    for (size_t i = 0; i < sizeof stages / sizeof stages[0] && !status; i++)
        status = stages[i](&w);
    release(&w);
    return status;
}

/* 1 when the arguments go together. */
static int check_settings(const settings *s)
{
    if (strcmp(s->tip, "bevel") != 0 && strcmp(s->tip, "symmetric") != 0)
        return options_complain("needle_prostate", "--tip", "needs bevel or symmetric");
    if (s->mesh && s->anatomy)
        return options_complain("needle_prostate", "--anatomy", "does not go with --mesh");
    if (s->lesion && !s->anatomy)
        return options_complain("needle_prostate", "--lesion", "goes with --anatomy");
    if (strlen(s->prefix) > PATH_SIZE - 64)
        return options_complain("needle_prostate", "-o", "needs a shorter prefix");
    if (s->mesh && s->csv && is_same_file(s->mesh, s->csv))
        return options_complain("needle_prostate", s->mesh, "would be overwritten");
    return 1;
}

static int program(int argc, char **argv)
{
    static settings s;
    s.tip = "bevel";
    s.prefix = "needle_prostate";
    s.seconds = 18;
    const option options[] = {
        {"--mesh", "FILE", OPTION_TEXT, NULL, NULL, &s.mesh, 0, 0,
         "tissue of tets in metres, the highest region is the prostate (VTK, VTU, gmsh, Medit, TetGen); default: made "
         "here"},
        {"--anatomy", NULL, OPTION_FLAG, &s.anatomy, NULL, NULL, 0, 0,
         "made here with skin of 6 mm and a pubic bone, in a mesh that is finer at their surfaces"},
        {"--lesion", NULL, OPTION_FLAG, &s.lesion, NULL, NULL, 0, 0,
         "with --anatomy: a stiff lesion of 12 mm that the mesh does not follow; springs hold the needle"},
        {"--tip", "KIND", OPTION_TEXT, NULL, NULL, &s.tip, 0, 0, "bevel or symmetric"},
        {"--seconds", "S", OPTION_NUMBER, NULL, &s.seconds, NULL, 0.5, 1e5, "length of the run, steps are of 0.02 s"},
        {"--csv", "FILE", OPTION_TEXT, NULL, NULL, &s.csv, 0, 0, "a line for each step"},
        {"-o", "PREFIX", OPTION_TEXT, NULL, NULL, &s.prefix, 0, 0, "files are named PREFIX_0000.vtk, PREFIX.png, ..."},
        {"--help", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, "this text"},
        {"-h", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, NULL},
    };
    const int count = (int)(sizeof options / sizeof options[0]);
    if (!options_parse("needle_prostate", options, count, NULL, 0, argc, argv))
        return EXIT_USAGE;
    if (s.help) {
        printf("usage: needle_prostate [OPTIONS]\n\n"
               "A flexible needle goes into a prostate phantom, is turned by half a turn, goes on, and is drawn out.\n"
               "Writes the tissue and the needle as VTK series, a chart (SVG) and a picture (PNG).\n\n");
        options_print(options, count);
        printf("\nThe last line: steps, median and 99th percentile of their time (ms), the share of steps whose\n"
               "friction states were consistent, the worst quality of a tet, and whether the mesh is the original one\n"
               "again (kept: springs hold the needle).\n");
        return 0;
    }
    return check_settings(&s) ? run(&s) : EXIT_USAGE;
}

int main(int argc, char **argv) { return finish("needle_prostate", program(argc, argv), EXIT_USAGE); }
