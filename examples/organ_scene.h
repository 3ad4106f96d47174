/* organ_scene.h: what the programs with tools share: an organ from a file or made, its skin, a body with a contact,
 * pictures and files for ParaView. Include it after the implementation of softbody.h.
 *
 *     organ o = organ_named("program");
 *     status = organ_load(&o, file, scale);       (or o.mesh is made, then)
 *     status = organ_make_skin(&o);
 *     status = organ_make_body(&o, &body_def, &contact_def);
 *     status = organ_add_tool(&o, &tool_def, &tool);
 *     status = organ_step(&o, dt);                (as often as wanted)
 *     organ_free(&o);
 *
 * Whatever returns a status gives 0 or, with a message printed, an exit status: 2 wrong usage or a file, 3 memory or a
 * step that failed. */
#ifndef ORGAN_SCENE_H
#define ORGAN_SCENE_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "options.h"
#include "picture.h"
#include "system.h"

enum { ORGAN_USAGE = 2, ORGAN_FAILED = 3, ORGAN_PATH = 1024 };

typedef struct organ {
    const char *program; /* for messages */
    sb_mesh mesh;        /* at rest */
    sb_boundary boundary;
    sb_surface *skin; /* at rest, to aim at */
    sb_vec3 low, high;
    sb_body *body;
    sb_contact *contact;
    sb_vec3 *places;  /* [nodes] deformed, for files and pictures */
    sb_real *numbers; /* [nodes] likewise */
    double seconds;   /* that the last step took */
    int frames;       /* of the series that were written */
} organ;

static inline organ organ_named(const char *program)
{
    organ o;
    memset(&o, 0, sizeof o);
    o.program = program;
    return o;
}

static inline void organ_free(organ *o)
{
    sb_contact_destroy(o->contact);
    sb_body_destroy(o->body);
    sb_surface_destroy(o->skin);
    sb_boundary_free(&o->boundary);
    sb_mesh_free(&o->mesh);
    free(o->places);
    free(o->numbers);
    memset(o, 0, sizeof *o);
}

/* ---- messages -------------------------------------------------------------------------------------------------- */

static inline int organ_complain(const organ *o, const char *about, const char *what, int status)
{
    progress_end();
    fprintf(stderr, "%s: %s%s%s\n", o->program, about ? about : "", about ? ": " : "", what);
    return status;
}

static inline int organ_complain_of(const organ *o, const char *about, const sb_error *error, int status)
{
    char place[ORGAN_PATH + 64];
    if (error->line > 0)
        snprintf(place, sizeof place, "%s:%d", error->file, error->line);
    else
        snprintf(place, sizeof place, "%s", error->file[0] ? error->file : about);
    return organ_complain(o, place, error->message, error->result == SB_ERROR_MEMORY ? ORGAN_FAILED : status);
}

static inline int organ_complain_memory(const organ *o)
{
    return organ_complain(o, NULL, "out of memory", ORGAN_FAILED);
}

static inline int organ_complain_file(const organ *o, const char *path)
{
    return organ_complain(o, path, "cannot be written", ORGAN_USAGE);
}

/* 1 when the name (or NULL) leaves room for what is put behind it; else says so. */
static inline int organ_check_name(const char *program, const char *about, const char *name)
{
    if (!name || strlen(name) <= ORGAN_PATH)
        return 1;
    return options_complain(program, about, "needs a shorter name");
}

/* Evenly spread in [0, 1), the same on every machine. */
static inline double organ_chance(unsigned long long *seed)
{
    unsigned long long z = *seed += 0x9e3779b97f4a7c15ull; /* splitmix64 */
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ z >> 27) * 0x94d049bb133111ebull;
    return (double)((z ^ z >> 31) >> 11) / 9007199254740992.0;
}

/* ---- the organ ------------------------------------------------------------------------------------------------- */

/* A volume mesh; lengths of the file times `scale` are m. */
static inline int organ_load(organ *o, const char *file, double scale)
{
    sb_load_options options = sb_default_load_options();
    sb_error error;
    options.scale = (sb_real)scale;
    if (sb_mesh_load(&o->mesh, file, &options, &error) != SB_OK)
        return organ_complain_of(o, file, &error, ORGAN_USAGE);
    if (sb_element_dimension(o->mesh.element_type) != 3)
        return organ_complain(o, file, "is a surface; a body needs a volume mesh: surface_to_sim fills it with tets",
                              ORGAN_USAGE);
    return 0;
}

/* Renumbers the mesh for speed and finds its surface. */
static inline int organ_make_skin(organ *o)
{
    sb_error error;
    sb_result result = sb_mesh_reorder(&o->mesh, NULL, NULL, &error);
    if (result == SB_OK)
        result = sb_mesh_boundary(&o->mesh, 1, NULL, &o->boundary, &error);
    if (result == SB_OK)
        result = sb_surface_create(&o->boundary.surface, NULL, &o->skin, &error);
    if (result != SB_OK)
        return organ_complain_of(o, "the organ", &error, ORGAN_USAGE);
    sb_mesh_bounds(&o->mesh, &o->low, &o->high);
    o->places = (sb_vec3 *)malloc((size_t)o->mesh.node_count * sizeof *o->places);
    o->numbers = (sb_real *)malloc((size_t)o->mesh.node_count * sizeof *o->numbers);
    return o->places && o->numbers ? 0 : organ_complain_memory(o);
}

/* given_contact NULL: nothing touches it. */
static inline int organ_make_body(organ *o, const sb_body_def *given, const sb_contact_def *given_contact)
{
    sb_body_def def = *given;
    sb_contact_def contact;
    sb_check_report report;
    sb_error error;
    def.mesh = &o->mesh;
    if (sb_body_create(&def, &o->body, &error) != SB_OK)
        return organ_complain_of(o, "the organ", &error, ORGAN_USAGE);
    if (given_contact) {
        contact = *given_contact;
        contact.body = o->body;
        if (sb_contact_create(&contact, &o->contact, &error) != SB_OK)
            return organ_complain_of(o, "contact", &error, ORGAN_USAGE);
    }
    if (sb_body_check(o->body, &report) == SB_OK && report.warnings & SB_CHECK_SIZE)
        fprintf(stderr, "%s: warning: the organ measures %.3g m; is it in millimetres? then add --scale 0.001\n",
                o->program, (double)report.size);
    return 0;
}

/* Normal of a face of the skin at rest, out of the organ, as long as its area (m^2); mid nodes are passed over. */
static inline sb_vec3 organ_face_area(const organ *o, int face)
{
    const sb_mesh *surface = &o->boundary.surface;
    const sb_vec3 *x = surface->nodes;
    const int corners = sb_element_corner_count(surface->element_type);
    const int *n = surface->elements + (size_t)face * (size_t)sb_mesh_element_width(surface);
    sb_vec3 one = sb_v3_sub(x[n[1]], x[n[0]]), other = sb_v3_sub(x[n[corners - 1]], x[n[0]]);
    if (corners == 4) /* of the diagonals */
        one = sb_v3_sub(x[n[2]], x[n[0]]), other = sb_v3_sub(x[n[3]], x[n[1]]);
    return sb_v3_scale((sb_real)0.5, sb_v3_cross(one, other));
}

/* Holds the nodes, from one x to another, of faces that look down; none: what is said where there are none. */
static inline int organ_hold_below(const organ *o, double from, double to, const char *none)
{
    const sb_mesh *surface = &o->boundary.surface;
    const sb_vec3 *x = surface->nodes;
    const int width = sb_mesh_element_width(surface);
    int held = 0;
    sb_error error;
    for (int f = 0; f < surface->element_count; f++) {
        const int *n = surface->elements + (size_t)f * (size_t)width;
        sb_vec3 normal = organ_face_area(o, f);
        if (normal.z > (sb_real)-0.5 * sb_v3_norm(normal))
            continue;
        for (int a = 0; a < width; a++) {
            if ((double)x[n[a]].x < from || (double)x[n[a]].x > to)
                continue;
            if (sb_body_hold(o->body, &o->boundary.nodes[n[a]], 1, SB_XYZ, &error) != SB_OK)
                return organ_complain_of(o, "the organ", &error, ORGAN_FAILED);
            held++;
        }
    }
    return held ? 0 : organ_complain(o, "the organ", none, ORGAN_USAGE);
}

/* The same as on a table, along all of it. */
static inline int organ_hold_on_table(const organ *o)
{
    return organ_hold_below(o, (double)o->low.x, (double)o->high.x, "has no side that looks down to lie on");
}

static inline int organ_add_tool(organ *o, const sb_tool_def *def, int *tool)
{
    sb_error error;
    if (sb_contact_add_tool(o->contact, def, tool, &error) != SB_OK)
        return organ_complain_of(o, "the tool", &error, ORGAN_USAGE);
    return 0;
}

static inline int organ_step(organ *o, double dt)
{
    sb_step_info info;
    double start = seconds_now();
    if (sb_body_step(o->body, (sb_real)dt, &info) != SB_OK)
        return organ_complain_of(o, "a step failed", &info.error, ORGAN_FAILED);
    o->seconds = seconds_now() - start;
    return 0;
}

/* ---- files ----------------------------------------------------------------------------------------------------- */

/* The next file of the series PREFIX_0000.vtk, ...: the deformed organ. */
static inline int organ_write_frame(organ *o, const char *prefix)
{
    char path[ORGAN_PATH + 32];
    sb_error error;
    sb_mesh deformed = o->mesh;
    const sb_field fields[2] = {
        {"displacement", SB_FIELD_NODES, 3, &sb_body_displacements(o->body)[0].x},
        {"von_mises", SB_FIELD_NODES, 1, o->numbers},
    };
    memcpy(o->places, sb_body_positions(o->body), (size_t)o->mesh.node_count * sizeof *o->places);
    deformed.nodes = o->places;
    sb_body_nodal_von_mises(o->body, o->numbers);
    snprintf(path, sizeof path, "%s_%04d.vtk", prefix, o->frames++);
    if (sb_mesh_save_vtk_binary(path, &deformed, fields, 2, &error) != SB_OK)
        return organ_complain_of(o, path, &error, ORGAN_USAGE);
    return 0;
}

/* Name of a file without its folders. */
static inline const char *organ_base_name(const char *path)
{
    const char *name = path;
    for (const char *c = path; *c; c++)
        if ((*c == '/' || *c == '\\') && c[1])
            name = c + 1;
    return name;
}

/* ParaView's list of the series; interval (s) between its files. */
static inline int organ_write_series(const organ *o, const char *prefix, double interval)
{
    char path[ORGAN_PATH + 32];
    sb_output out;
    snprintf(path, sizeof path, "%s.vtk.series", prefix);
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return organ_complain_file(o, path);
    fprintf(out.file, "{\"file-series-version\": \"1.0\", \"files\": [\n");
    for (int i = 0; i < o->frames; i++)
        fprintf(out.file, "  {\"name\": \"%s_%04d.vtk\", \"time\": %.6g}%s\n", organ_base_name(prefix), i, i * interval,
                i + 1 < o->frames ? "," : "");
    fprintf(out.file, "]}\n");
    return sb_output_close(&out, NULL) == SB_OK ? 0 : organ_complain_file(o, path);
}

/* Writes the picture and ends it. */
static inline int organ_save_picture(const organ *o, picture *p, const char *path)
{
    int result = picture_save_png(p, path);
    picture_end(p);
    return result == PICTURE_OK        ? 0
           : result == PICTURE_NO_FILE ? organ_complain_file(o, path)
                                       : organ_complain_memory(o);
}

/* ---- pictures -------------------------------------------------------------------------------------------------- */

/* Adds the skin at places [nodes], coloured by values [nodes] from 0 to most. */
static inline void organ_draw(const organ *o, picture *p, const sb_vec3 *places, const sb_real *values, double most)
{
    sb_mesh surface = o->boundary.surface;
    size_t count = (size_t)surface.node_count;
    sb_real *shown = (sb_real *)malloc(count * sizeof *shown);
    surface.nodes = (sb_vec3 *)malloc(count * sizeof *surface.nodes);
    p->out_of_memory = p->out_of_memory || !shown || !surface.nodes;
    if (!p->out_of_memory) {
        for (size_t i = 0; i < count; i++) {
            surface.nodes[i] = places[o->boundary.nodes[i]];
            shown[i] = values[o->boundary.nodes[i]];
        }
        picture_add_surface(p, &surface, shown, 0, most);
    }
    free(shown);
    free(surface.nodes);
}

static inline int organ_by_size(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Sorts the values. */
static inline double organ_median(double *values, int count)
{
    qsort(values, (size_t)count, sizeof *values, organ_by_size);
    return count ? 0.5 * (values[(count - 1) / 2] + values[count / 2]) : 0;
}

#endif /* ORGAN_SCENE_H */
