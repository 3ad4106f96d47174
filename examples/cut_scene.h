/* cut_scene.h: what the programs that cut share: an organ that can be cut, what is drawn of it, and its parts. Include
 * it after organ_scene.h.
 *
 *     cut_scene c;
 *     memset(&c, 0, sizeof c);
 *     c.scene = organ_named("program");
 *     ... organ_load and organ_make_skin ...
 *     status = cut_scene_make(&c, &body_def, lattice, SB_CUT_LAG, strokes);
 *     ... sb_cut_triangles(c.cut, ...), organ_step(&c.scene, dt) ...
 *     status = cut_scene_look(&c);             the surface and the parts as they are now
 * Free parts smaller than an element, which cuts leave that meet, are taken out (sb_cut_def.least_piece); what is as
 * small and held is a crumb, and neither drawn nor counted.
 *     cut_scene_draw(&c, &picture, ...);
 *     cut_scene_free(&c);
 *
 * Statuses are those of organ_scene.h. */
#ifndef CUT_SCENE_H
#define CUT_SCENE_H

#include "cut_file.h"
#include "organ_scene.h"

enum { CUT_SCENE_PARTS = 64 };

typedef struct cut_scene {
    organ scene;
    sb_cut *cut;
    sb_cut_surface *surface;
    double least;                   /* m^3, of a part that is no crumb */
    sb_part parts[CUT_SCENE_PARTS]; /* the first so many that are no crumbs */
    int part_count, crumb_count;
    int *numbers; /* [nodes of the body] the part of each; -1: none, or a crumb */
    int number_room;
    sb_part *all; /* [all_room] crumbs too */
    int all_room;
} cut_scene;

static inline void cut_scene_free(cut_scene *c)
{
    sb_cut_surface_destroy(c->surface);
    sb_cut_destroy(c->cut);
    organ_free(&c->scene);
    free(c->numbers);
    free(c->all);
    memset(c, 0, sizeof *c);
}

/* Makes the organ's mesh, which is loaded, one of tet10 where quadratic is 1 and it is not. Before organ_make_skin. */
static inline int cut_scene_raise(cut_scene *c, int quadratic)
{
    sb_mesh mesh, *old = &c->scene.mesh;
    sb_error error;
    if (!quadratic || old->element_type != SB_TET4)
        return 0;
    if (sb_mesh_to_tet10(old, NULL, &mesh, &error) != SB_OK)
        return organ_complain_of(&c->scene, "the organ", &error, ORGAN_USAGE);
    sb_mesh_free(old);
    *old = mesh;
    return 0;
}

static inline int cut_scene_check(const cut_scene *c)
{
    if (c->scene.mesh.element_type == SB_TET4 || c->scene.mesh.element_type == SB_TET10)
        return 0;
    return organ_complain(&c->scene, "the organ", "is cut as tet4 or tet10 only: load a mesh of tetrahedra",
                          ORGAN_USAGE);
}

/* A body of the organ's mesh, and what cuts it; strokes: at once. */
static inline int cut_scene_make(cut_scene *c, const sb_body_def *given, int lattice, sb_cut_front front, int strokes)
{
    sb_body_def def = *given;
    sb_cut_def cut = sb_default_cut_def();
    sb_error error;
    int status;
    status = cut_scene_check(c);
    if (status)
        return status;
    def.slack = (sb_real)0.5;
    status = organ_make_body(&c->scene, &def, NULL);
    if (status)
        return status;
    cut.body = c->scene.body;
    cut.lattice = lattice;
    cut.front = front;
    cut.max_strokes = strokes;
    c->least = 0;
    for (int e = 0; e < c->scene.mesh.element_count; e++)
        c->least += (double)sb_mesh_element_volume(&c->scene.mesh, e) / c->scene.mesh.element_count;
    if (sb_cut_create(&cut, &c->cut, &error) != SB_OK || sb_cut_surface_create(c->cut, NULL, &c->surface, &error))
        return organ_complain_of(&c->scene, "the cut", &error, ORGAN_USAGE);
    return 0;
}

/* Lists for what there is now; 0: no memory. */
static inline int cut_scene_reserve(cut_scene *c)
{
    int nodes = sb_body_node_count(c->scene.body), parts = 0;
    sb_body_parts(c->scene.body, NULL, 0, &parts, NULL);
    if (nodes > c->number_room) {
        free(c->numbers);
        c->numbers = (int *)malloc(2 * (size_t)nodes * sizeof *c->numbers);
        c->number_room = c->numbers ? 2 * nodes : 0;
    }
    if (parts > c->all_room || !c->all) {
        free(c->all);
        c->all = (sb_part *)malloc((2 * (size_t)parts + 1) * sizeof *c->all);
        c->all_room = c->all ? 2 * parts : 0;
    }
    return c->numbers && c->all;
}

static inline void cut_scene_list_parts(cut_scene *c)
{
    sb_body *body = c->scene.body;
    int all = 0;
    c->part_count = c->crumb_count = 0;
    sb_body_parts(body, c->all, c->all_room, &all, c->numbers);
    for (int k = 0; k < all; k++) {
        int is_crumb = (double)c->all[k].volume < c->least;
        if (!is_crumb && c->part_count < CUT_SCENE_PARTS)
            c->parts[c->part_count] = c->all[k];
        c->all[k].node_count = is_crumb ? -1 : c->part_count; /* its number from now on */
        c->part_count += !is_crumb;
        c->crumb_count += is_crumb;
    }
    for (int i = 0; i < sb_body_node_count(body); i++)
        c->numbers[i] = c->numbers[i] < 0 ? -1 : c->all[c->numbers[i]].node_count;
}

/* Brings the surface and the list of parts to what the body is now. */
static inline int cut_scene_look(cut_scene *c)
{
    sb_error error;
    if (!cut_scene_reserve(c))
        return organ_complain_memory(&c->scene);
    cut_scene_list_parts(c);
    if (sb_cut_surface_update(c->surface, &error) != SB_OK)
        return organ_complain_of(&c->scene, "the surface", &error, ORGAN_FAILED);
    return 0;
}

/* 1 when some node of the part is supported. */
static inline int cut_scene_is_held(const cut_scene *c, int part)
{
    const unsigned char *supports = sb_body_supports(c->scene.body);
    for (int i = 0; i < sb_body_node_count(c->scene.body); i++)
        if (c->numbers[i] == part && supports[i])
            return 1;
    return 0;
}

/* The part of a triangle of the surface, -1: it is not drawn. */
static inline int cut_scene_part_of(const cut_scene *c, const sb_cut_drawing *d, int triangle)
{
    const int *corners = d->triangles[triangle], *nodes = sb_body_cell_nodes(c->scene.body, d->cells[triangle]);
    int part = -1;
    for (int a = 0; nodes && corners[0] != corners[1] && a < 4; a++) /* a copy without material is of no part */
        part = part < 0 ? c->numbers[nodes[a]] : part;
    return part;
}

/* ---- pictures -------------------------------------------------------------------------------------------------- */

/* Colours of tissue: skin, and what a cut or a burn laid open. */
static inline picture_colour cut_scene_skin(void) { return picture_web(0x9e4a45); }
static inline picture_colour cut_scene_lip(void) { return picture_web(0xf7a184); }
static inline picture_colour cut_scene_char(void) { return picture_web(0x59412f); }

/* Adds the skin of the body and its lips, these coloured by values [vertices] from 0 to most unless NULL. */
static inline void cut_scene_draw(const cut_scene *c, picture *p, const sb_real *values, double most)
{
    sb_cut_drawing d = sb_cut_surface_get(c->surface);
    for (int i = 0; i < d.triangle_count; i++) {
        const int *corners = d.triangles[i];
        picture_triangle *t = cut_scene_part_of(c, &d, i) < 0 ? NULL : picture_new_triangle(p);
        if (!t)
            continue;
        memset(t, 0, sizeof *t);
        t->is_plain = d.tags[i] != SB_CUT_LIP || !values;
        t->colour = d.tags[i] == SB_CUT_LIP    ? cut_scene_lip()
                    : d.tags[i] == SB_CUT_CHAR ? cut_scene_char()
                                               : cut_scene_skin();
        for (int k = 0; k < 3; k++) {
            t->corner[k] = picture_from(d.positions[corners[k]]);
            t->normal[k] = picture_from(d.normals[corners[k]]);
            t->value[k] = values ? (double)values[corners[k]] / most : 0;
            picture_grow_box(p, t->corner[k]);
        }
    }
}

/* ---- files ----------------------------------------------------------------------------------------------------- */

/* The next file of the series PREFIX_0000.vtk, ...: skin, lips and walls of holes, with displacement, `lip` (0 skin, 1
 * cut, 2 burnt) and `part`. */
static inline int cut_scene_write_frame(cut_scene *c, const char *prefix)
{
    char path[ORGAN_PATH + 32];
    sb_cut_drawing d = sb_cut_surface_get(c->surface);
    unsigned char *crumbs = (unsigned char *)calloc((size_t)d.triangle_count + 1, 1);
    sb_real *part = (sb_real *)calloc((size_t)d.triangle_count + 1, sizeof *part);
    sb_error error;
    cut_file file;
    int status = 0;
    memset(&file, 0, sizeof file);
    for (int i = 0; crumbs && i < d.triangle_count; i++)
        crumbs[i] = cut_scene_part_of(c, &d, i) < 0;
    snprintf(path, sizeof path, "%s_%04d.vtk", prefix, c->scene.frames);
    if (crumbs && part && cut_file_make(&file, &d, crumbs)) { /* nothing is written of what has all been taken out */
        sb_field fields[3] = {{"displacement", SB_FIELD_NODES, 3, NULL},
                              {"lip", SB_FIELD_ELEMENTS, 1, NULL},
                              {"part", SB_FIELD_ELEMENTS, 1, NULL}};
        fields[0].values = file.displacement, fields[1].values = file.lip, fields[2].values = part;
        for (int i = 0; i < file.mesh.element_count; i++)
            part[i] = (sb_real)cut_scene_part_of(c, &d, file.triangles[i]);
        if (file.mesh.element_count > 0 && sb_mesh_save_vtk_binary(path, &file.mesh, fields, 3, &error) != SB_OK)
            status = organ_complain_of(&c->scene, path, &error, ORGAN_USAGE);
        c->scene.frames += !status && file.mesh.element_count > 0;
    } else {
        status = organ_complain_memory(&c->scene);
    }
    cut_file_free(&file);
    free(crumbs);
    free(part);
    return status;
}

/* ---- readings -------------------------------------------------------------------------------------------------- */

/* A vertex of a lip, by its place at rest. */
typedef struct cut_scene_mark {
    sb_vec3 rest, now;
} cut_scene_mark;

static inline int cut_scene_order(sb_vec3 p, sb_vec3 q)
{
    if (p.x != q.x)
        return p.x < q.x ? -1 : 1;
    if (p.y != q.y)
        return p.y < q.y ? -1 : 1;
    return (p.z > q.z) - (p.z < q.z);
}

static inline int cut_scene_by_rest(const void *a, const void *b)
{
    const cut_scene_mark *m = (const cut_scene_mark *)a, *n = (const cut_scene_mark *)b;
    int order = cut_scene_order(m->rest, n->rest);
    return order ? order : cut_scene_order(m->now, n->now);
}

/* How far (m) points of both lips that were one are apart at most; -1: no memory. */
static inline double cut_scene_gape(const cut_scene *c)
{
    sb_cut_drawing d = sb_cut_surface_get(c->surface);
    cut_scene_mark *marks = (cut_scene_mark *)malloc((3 * (size_t)d.triangle_count + 1) * sizeof *marks);
    size_t count = 0;
    double most = 0;
    for (int i = 0; marks && i < d.triangle_count; i++)
        for (int k = 0; k < 3 && d.tags[i] == SB_CUT_LIP && cut_scene_part_of(c, &d, i) >= 0; k++) {
            marks[count].rest = d.rest[d.triangles[i][k]];
            marks[count++].now = d.positions[d.triangles[i][k]];
        }
    if (!marks)
        return -1;
    qsort(marks, count, sizeof *marks, cut_scene_by_rest);
    for (size_t i = 1; i < count; i++)
        if (cut_scene_order(marks[i - 1].rest, marks[i].rest) == 0)
            most = fmax(most, (double)sb_v3_norm(sb_v3_sub(marks[i].now, marks[i - 1].now)));
    free(marks);
    return most;
}

/* Prints the parts, largest first, and what is left of many. */
static inline void cut_scene_print_parts(const cut_scene *c)
{
    enum { SHOWN = 6 };
    int count = c->part_count < CUT_SCENE_PARTS ? c->part_count : CUT_SCENE_PARTS, shown[CUT_SCENE_PARTS] = {0};
    for (int line = 0; line < count && line < SHOWN; line++) {
        const sb_part *p;
        int largest = -1;
        for (int k = 0; k < count; k++)
            if (!shown[k] && (largest < 0 || c->parts[k].volume > c->parts[largest].volume))
                largest = k;
        shown[largest] = 1;
        p = c->parts + largest;
        printf("part %-6d %.2f ml, %.2f g, centre (%.1f, %.1f, %.1f) mm, %s\n", largest, 1e6 * (double)p->volume,
               1e3 * (double)p->mass, 1e3 * (double)p->centre.x, 1e3 * (double)p->centre.y, 1e3 * (double)p->centre.z,
               cut_scene_is_held(c, largest) ? "held" : "free");
    }
    if (c->part_count > SHOWN)
        printf("            and %d more\n", c->part_count - SHOWN);
    if (c->crumb_count)
        printf("crumbs      %d smaller than an element, held where they are\n", c->crumb_count);
}

#endif /* CUT_SCENE_H */
