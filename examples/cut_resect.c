/* cut_resect: a wedge with a tumour in it is cut out of an organ and lifted out.
 *
 *     cut_resect [ORGAN] [OPTIONS]      cut_resect --help lists the options
 *
 * Without files an organ like a liver is made, with a stiffer tumour below its skin. It lies on a table. The wedge is
 * planned where the organ has come to rest: two planes that meet below the tumour and two across them, with a margin of
 * healthy tissue. It is cut out at once, and a grasper, which holds the tissue above the tumour, lifts it. Written are
 * the course of the lift (CSV), a picture with the distance of what was laid open from the tumour, and series of skin
 * and lips and of the tumour for ParaView; the same on every machine. Exit status: 0, 2 wrong usage or a file that
 * cannot be read or written, 3 a step failed or memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "cut_scene.h"
#include "options.h"

#include "cut_options.h"

#define REAL(x) ((sb_real)(x)) /* everything here computes in double, the body in sb_real */

static const char *const program_name = "cut_resect";
static const double gravity = 9.81;   /* m/s^2 */
static const double density = 1060;   /* kg/m^3 */
static const double settling = 0.4;   /* s, after the cut and after the lift */
static const double lift_speed = 0.1; /* m/s */

typedef struct settings {
    cut_settings cut;
    const char *tumour;
    double ratio, size, depth, x, y, margin, angle, lift;
} settings;

/* What a frame ended with. */
typedef struct frame {
    double time, lift, carried, gape; /* s, m, N, m */
} frame;

typedef struct work {
    const settings *set;
    cut_scene c;
    sb_mesh tumour;           /* tri3, at rest */
    sb_surface *shape;        /* of it, at rest */
    sb_embedding *inside;     /* its nodes in the organ */
    sb_vec3 *now;             /* [tumour nodes] */
    double volume;            /* m^3, of the tumour */
    int wedge;                /* the part that is lifted out */
    int astray;               /* tumour nodes that are in another */
    sb_real *distances;       /* [vertices of the surface] of lips from the tumour at rest (m) */
    double margin, farthest;  /* m: the least and the largest of the wedge's own */
    int *grip, grip_count;    /* nodes that the grasper holds */
    sb_vec3 *grip_at, handle; /* m: where they were; their middle */
    frame *frames;
    int frame_count;
} work;

/* ---- organ and tumour ------------------------------------------------------------------------------------------ */

static int make_mesh(work *w)
{
    const settings *s = w->set;
    organ *o = &w->c.scene;
    sb_error error;
    int status = 0;
    *o = organ_named(program_name);
    if (s->cut.organ)
        status = organ_load(o, s->cut.organ, s->cut.scale);
    else if (sb_mesh_organ(SB_TET4, s->cut.cells, NULL, &o->mesh, &error) != SB_OK)
        status = organ_complain_of(o, "the organ", &error, ORGAN_USAGE);
    if (!status)
        status = cut_scene_raise(&w->c, s->cut.quadratic);
    if (!status)
        status = cut_scene_check(&w->c);
    return status ? status : organ_make_skin(o);
}

/* A slightly flat ball below the skin. */
static int grow_tumour(work *w)
{
    const settings *s = w->set;
    const organ *o = &w->c.scene;
    const double size = s->size;
    sb_vec3 axes = sb_v3(REAL(size), REAL(1.15 * size), REAL(0.85 * size)), from, middle;
    sb_surface_hit hit;
    sb_boundary skin;
    sb_mesh ball;
    sb_error error;
    sb_result result;
    from.x = o->low.x + REAL(s->x) * (o->high.x - o->low.x);
    from.y = o->low.y + REAL(s->y) * (o->high.y - o->low.y);
    from.z = o->high.z + (o->high.z - o->low.z);
    if (!sb_surface_ray(o->skin, from, sb_v3(0, 0, -1), SB_REAL_MAX, &hit))
        return organ_complain(o, "the tumour", "has no organ there: choose another --x or --y", ORGAN_USAGE);
    middle = sb_v3_madd(hit.point, REAL(-s->depth), sb_v3(0, 0, 1));
    memset(&ball, 0, sizeof ball);
    result = sb_mesh_ellipsoid(SB_TET4, axes, 8, NULL, &ball, &error);
    if (result == SB_OK)
        result = sb_mesh_boundary(&ball, 1, NULL, &skin, &error);
    if (result == SB_OK) {
        for (int i = 0; i < skin.surface.node_count; i++)
            skin.surface.nodes[i] = sb_v3_add(skin.surface.nodes[i], middle);
        result = sb_mesh_copy(&skin.surface, NULL, &w->tumour, &error);
        sb_boundary_free(&skin);
    }
    sb_mesh_free(&ball);
    return result == SB_OK ? 0 : organ_complain_of(o, "the tumour", &error, ORGAN_USAGE);
}

static int load_tumour(work *w)
{
    const char *file = w->set->tumour;
    sb_load_options options = sb_default_load_options();
    sb_error error;
    options.scale = REAL(w->set->cut.scale);
    if (sb_mesh_load(&w->tumour, file, &options, &error) != SB_OK)
        return organ_complain_of(&w->c.scene, file, &error, ORGAN_USAGE);
    if (w->tumour.element_type != SB_TRI3)
        return organ_complain(&w->c.scene, file, "is no surface of triangles", ORGAN_USAGE);
    return 0;
}

static int make_tumour(work *w)
{
    const organ *o = &w->c.scene;
    const char *name = w->set->tumour ? w->set->tumour : "the tumour";
    sb_surface_report report;
    sb_error error;
    int status = w->set->tumour ? load_tumour(w) : grow_tumour(w);
    if (status)
        return status;
    if (sb_surface_require(&w->tumour, SB_SURFACE_NOT_SOLID, NULL, &report, &error) != SB_OK ||
        sb_surface_create(&w->tumour, NULL, &w->shape, &error) != SB_OK)
        return organ_complain_of(o, name, &error, ORGAN_USAGE);
    w->volume = (double)report.volume;
    for (int i = 0; i < w->tumour.node_count; i++)
        if (!sb_surface_inside(o->skin, w->tumour.nodes[i]))
            return organ_complain(o, name, "sticks out of the organ", ORGAN_USAGE);
    return 0;
}

/* Elements whose middle is in the tumour are a region of their own. */
static int stiffen_tumour(work *w)
{
    sb_mesh *mesh = &w->c.scene.mesh;
    const int n = sb_element_node_count(mesh->element_type);
    if (sb_element_corner_count(mesh->element_type) != 4)
        return 0; /* which is refused later */
    if (!mesh->regions)
        mesh->regions = (int *)malloc((size_t)mesh->element_count * sizeof(int));
    if (!mesh->regions)
        return organ_complain_memory(&w->c.scene);
    for (int e = 0; e < mesh->element_count; e++) {
        sb_vec3 sum = sb_v3(0, 0, 0);
        for (int a = 0; a < 4; a++)
            sum = sb_v3_madd(sum, REAL(0.25), mesh->nodes[mesh->elements[n * e + a]]);
        mesh->regions[e] = sb_surface_inside(w->shape, sum);
    }
    return 0;
}

static int has_stiff_element(const sb_mesh *mesh)
{
    for (int e = 0; e < mesh->element_count; e++)
        if (mesh->regions && mesh->regions[e])
            return 1;
    return 0;
}

static int embed_tumour(work *w)
{
    sb_embedding_def def = sb_default_embedding_def();
    sb_error error;
    def.mesh = &w->c.scene.mesh;
    def.points = w->tumour.nodes;
    def.point_count = w->tumour.node_count;
    w->now = (sb_vec3 *)malloc((size_t)w->tumour.node_count * sizeof *w->now);
    if (!w->now)
        return organ_complain_memory(&w->c.scene);
    if (sb_embedding_create(&def, &w->inside, &error) != SB_OK ||
        sb_embedding_follow(w->inside, w->c.scene.body, &error) != SB_OK)
        return organ_complain_of(&w->c.scene, "the tumour", &error, ORGAN_FAILED);
    return 0;
}

static int make_scene(work *w)
{
    const settings *s = w->set;
    organ *o = &w->c.scene;
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_region_material stiff;
    sb_step_info info;
    int status;
    def.material = sb_material_corotated(REAL(s->cut.young), REAL(s->cut.poisson), REAL(density));
    stiff.region = 1;
    stiff.material = sb_material_corotated(REAL(s->cut.young * s->ratio), REAL(s->cut.poisson), REAL(density));
    def.region_materials = &stiff;
    def.region_material_count = has_stiff_element(&o->mesh);
    def.gravity = sb_v3(0, 0, REAL(-gravity));
    def.damping_stiffness = REAL(0.03);
    status = cut_scene_make(&w->c, &def, s->cut.lattice, cut_settings_front(&s->cut), 0);
    if (!status)
        status = organ_hold_on_table(o);
    if (!status)
        status = embed_tumour(w);
    if (status)
        return status;
    options.tolerance = REAL(1e-4);
    if (sb_body_solve_static(o->body, &options, &info) != SB_OK)
        return organ_complain_of(o, "the organ does not come to rest on the table", &info.error, ORGAN_FAILED);
    return 0;
}

/* ---- the wedge ------------------------------------------------------------------------------------------------- */

/* How far the tumour reaches along a direction, where it is now (m). */
static double reach(const work *w, double x, double y, double z)
{
    double most = -HUGE_VAL;
    for (int i = 0; i < w->tumour.node_count; i++)
        most = fmax(most, x * (double)w->now[i].x + y * (double)w->now[i].y + z * (double)w->now[i].z);
    return most;
}

/* Corners of the wedge: two of the edge below, two of the left side above the organ, two of the right. Its sides have
 * the normals (-+ cos a, 0, -sin a), and keep off the tumour by the margin as its ends do. */
static void plan_wedge(const work *w, sb_vec3 corners[6])
{
    const double pi = 3.14159265358979323846;
    double c = cos(w->set->angle * pi / 180), s = sin(w->set->angle * pi / 180), margin = w->set->margin;
    double left = reach(w, -c, 0, -s) + margin, right = reach(w, c, 0, -s) + margin;
    double ends[2], x = (right - left) / (2 * c), z = -(right + left) / (2 * s), top = z;
    ends[0] = -(reach(w, 0, -1, 0) + margin);
    ends[1] = reach(w, 0, 1, 0) + margin;
    for (int i = 0; i < sb_body_node_count(w->c.scene.body); i++)
        top = fmax(top, (double)sb_body_positions(w->c.scene.body)[i].z);
    top += margin;
    for (int k = 0; k < 2; k++) {
        corners[k] = sb_v3(REAL(x), REAL(ends[k]), REAL(z));
        corners[2 + k] = sb_v3(REAL(x - (top - z) * s / c), REAL(ends[k]), REAL(top));
        corners[4 + k] = sb_v3(REAL(x + (top - z) * s / c), REAL(ends[k]), REAL(top));
    }
}

/* The largest part that nothing holds, and what of the tumour is not in it; 0: all are held. */
static int find_wedge(work *w)
{
    int count = w->c.part_count < CUT_SCENE_PARTS ? w->c.part_count : CUT_SCENE_PARTS;
    w->wedge = -1;
    for (int k = 0; k < count; k++)
        if (!cut_scene_is_held(&w->c, k) && (w->wedge < 0 || w->c.parts[k].volume > w->c.parts[w->wedge].volume))
            w->wedge = k;
    for (int i = 0; i < w->tumour.node_count; i++) {
        sb_embedded_point point;
        const int *nodes = NULL;
        if (sb_embedding_get_point(w->inside, i, &point) == SB_OK)
            nodes = sb_body_cell_nodes(w->c.scene.body, point.element);
        w->astray += !nodes || w->c.numbers[nodes[0]] != w->wedge;
    }
    return w->wedge >= 0;
}

/* Distances of the lips' vertices from the tumour, at rest, and what margin the wedge has. */
static int measure_margin(work *w)
{
    sb_cut_drawing d = sb_cut_surface_get(w->c.surface);
    free(w->distances);
    w->distances = (sb_real *)calloc((size_t)d.vertex_count + 1, sizeof *w->distances);
    if (!w->distances)
        return organ_complain_memory(&w->c.scene);
    w->margin = HUGE_VAL, w->farthest = 0;
    for (int i = 0; i < d.triangle_count; i++)
        for (int k = 0; k < 3 && d.tags[i] == SB_CUT_LIP && cut_scene_part_of(&w->c, &d, i) >= 0; k++) {
            int vertex = d.triangles[i][k];
            w->distances[vertex] = sb_surface_signed_distance(w->shape, d.rest[vertex], NULL);
            if (cut_scene_part_of(&w->c, &d, i) != w->wedge)
                continue;
            w->margin = fmin(w->margin, (double)w->distances[vertex]);
            w->farthest = fmax(w->farthest, (double)w->distances[vertex]);
        }
    return 0;
}

static int cut_wedge(work *w)
{
    static const int faces[8][3] = {{0, 1, 3}, {0, 3, 2}, {1, 0, 4}, {1, 4, 5},
                                    {0, 2, 4}, {1, 5, 3}, {2, 3, 5}, {2, 5, 4}};
    sb_vec3 corners[6], triangles[24];
    sb_error error;
    int status;
    sb_embedding_update(w->inside, sb_body_positions(w->c.scene.body), w->now, NULL, NULL);
    plan_wedge(w, corners);
    for (int k = 0; k < 24; k++)
        triangles[k] = corners[faces[k / 3][k % 3]];
    if (sb_cut_triangles(w->c.cut, triangles, 8, NULL, &error) != SB_OK)
        return organ_complain_of(&w->c.scene, "the wedge", &error, ORGAN_FAILED);
    status = cut_scene_look(&w->c);
    if (status)
        return status;
    if (!find_wedge(w))
        return organ_complain(&w->c.scene, "the wedge",
                              "does not come loose, it goes through to the table: take less --margin or --depth, or "
                              "another place",
                              ORGAN_USAGE);
    return measure_margin(w);
}

/* The grasper holds the nodes of the wedge next to the skin above its tumour: three at least, and those that are not
 * much farther. */
static int grip_wedge(work *w)
{
    const sb_body *body = w->c.scene.body;
    int nodes = sb_body_node_count(body);
    sb_vec3 top = sb_v3(0, 0, 0);
    double radius = 0.5 * cbrt(w->c.least);
    for (int i = 0; i < w->tumour.node_count; i++)
        top = sb_v3_madd(top, REAL(1.0 / w->tumour.node_count), w->now[i]);
    top.z = REAL(-HUGE_VAL);
    for (int i = 0; i < nodes; i++)
        if (w->c.numbers[i] == w->wedge)
            top.z = sb_max(top.z, sb_body_positions(body)[i].z);
    w->grip = (int *)malloc((size_t)nodes * sizeof *w->grip);
    w->grip_at = (sb_vec3 *)malloc((size_t)nodes * sizeof *w->grip_at);
    if (!w->grip || !w->grip_at)
        return organ_complain_memory(&w->c.scene);
    while (w->grip_count < 3) {
        radius *= 1.3;
        w->grip_count = 0;
        for (int i = 0; i < nodes; i++)
            if (w->c.numbers[i] == w->wedge &&
                (double)sb_v3_norm(sb_v3_sub(sb_body_positions(body)[i], top)) < radius) {
                w->grip_at[w->grip_count] = sb_body_positions(body)[i];
                w->grip[w->grip_count++] = i;
            }
        if (w->grip_count == w->c.parts[w->wedge].node_count)
            break;
    }
    w->handle = sb_v3(0, 0, 0);
    for (int k = 0; k < w->grip_count; k++)
        w->handle = sb_v3_madd(w->handle, REAL(1.0 / w->grip_count), w->grip_at[k]);
    return 0;
}

/* ---- lifting --------------------------------------------------------------------------------------------------- */

static int write_tumour(work *w)
{
    char path[ORGAN_PATH + 48];
    sb_mesh moved = w->tumour;
    sb_error error;
    moved.nodes = w->now;
    snprintf(path, sizeof path, "%s_tumour_%04d.vtk", w->set->cut.out, w->c.scene.frames);
    return sb_mesh_save_vtk_binary(path, &moved, NULL, 0, &error) == SB_OK
               ? 0
               : organ_complain_of(&w->c.scene, path, &error, ORGAN_USAGE);
}

/* Steps with the grasper raised by `lift` (m). */
static int run_frame(work *w, int i, double lift)
{
    frame *f = w->frames + i;
    sb_body *body = w->c.scene.body;
    sb_error error;
    int status;
    for (int k = 0; k < w->grip_count; k++) {
        sb_vec3 to = sb_v3_madd(w->grip_at[k], REAL(lift), sb_v3(0, 0, 1));
        if (sb_body_place(body, &w->grip[k], 1, SB_XYZ, &to, &error) != SB_OK)
            return organ_complain_of(&w->c.scene, "the grasper", &error, ORGAN_FAILED);
    }
    status = organ_step(&w->c.scene, 1 / w->set->cut.rate);
    if (!status)
        status = cut_scene_look(&w->c);
    if (status)
        return status;
    f->time = (i + 1) / w->set->cut.rate;
    f->lift = lift;
    for (int k = 0; k < w->grip_count; k++)
        f->carried += (double)sb_body_reactions(body)[w->grip[k]].z;
    f->gape = cut_scene_gape(&w->c);
    sb_embedding_update(w->inside, sb_body_positions(body), w->now, NULL, NULL);
    if (w->set->cut.every > 0 && (i + 1) % w->set->cut.every == 0) {
        status = write_tumour(w);
        if (!status)
            status = cut_scene_write_frame(&w->c, w->set->cut.out);
    }
    return status;
}

static int lift_wedge(work *w)
{
    const settings *s = w->set;
    int rest = (int)ceil(settling * s->cut.rate), way = (int)ceil(s->lift / lift_speed * s->cut.rate), status = 0;
    w->frame_count = 2 * rest + way;
    w->frames = (frame *)calloc((size_t)w->frame_count, sizeof *w->frames);
    if (!w->frames)
        return organ_complain_memory(&w->c.scene);
    for (int i = 0; i < w->frame_count && !status; i++) {
        double lift = way ? s->lift * fmax(0, fmin(1, (double)(i + 1 - rest) / way)) : 0;
        char words[64];
        status = run_frame(w, i, lift);
        snprintf(words, sizeof words, "lifted by %.0f mm", 1e3 * lift);
        progress_show((double)(i + 1) / w->frame_count, words);
    }
    progress_end();
    if (!status && w->c.scene.frames) {
        char tumour[ORGAN_PATH + 16];
        snprintf(tumour, sizeof tumour, "%s_tumour", s->cut.out);
        status = organ_write_series(&w->c.scene, s->cut.out, s->cut.every / s->cut.rate);
        if (!status)
            status = organ_write_series(&w->c.scene, tumour, s->cut.every / s->cut.rate);
    }
    return status;
}

/* ---- what is written ------------------------------------------------------------------------------------------- */

static int write_table(work *w)
{
    char path[ORGAN_PATH + 32];
    sb_output out;
    snprintf(path, sizeof path, "%s.csv", w->set->cut.out);
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return organ_complain_file(&w->c.scene, path);
    fprintf(out.file, "time_s,lift_mm,carried_N,gape_mm\n");
    for (int i = 0; i < w->frame_count; i++)
        fprintf(out.file, "%.6g,%.4g,%.5g,%.4g\n", w->frames[i].time, 1e3 * w->frames[i].lift, w->frames[i].carried,
                1e3 * w->frames[i].gape);
    return sb_output_close(&out, NULL) == SB_OK ? 0 : organ_complain_file(&w->c.scene, path);
}

/* Two jaws of a grasper that come from above. */
static void draw_grasper(const work *w, picture *p)
{
    sb_vec3 low, high, at = sb_v3_madd(w->handle, REAL(w->set->lift), sb_v3(0, 0, 1));
    double size, thick;
    sb_mesh_bounds(&w->c.scene.mesh, &low, &high);
    size = (double)(high.x - low.x);
    thick = 0.012 * size;
    for (int side = -1; side <= 1; side += 2) {
        sb_vec3 tip = sb_v3_add(at, sb_v3(REAL(side * 1.2 * thick), 0, REAL(0.3 * thick)));
        picture_add_capsule(p, tip, sb_v3_add(at, sb_v3(REAL(side * 0.6 * thick), 0, REAL(0.12 * size))), 0.7 * thick,
                            picture_web(0x8d99a6));
    }
    picture_add_capsule(p, sb_v3_add(at, sb_v3(0, 0, REAL(0.12 * size))), sb_v3_add(at, sb_v3(0, 0, REAL(0.25 * size))),
                        thick, picture_web(0x8d99a6));
}

static int draw_picture(work *w)
{
    const int width = 1280, height = 960;
    const sb_part *wedge = w->c.parts + w->wedge;
    char path[ORGAN_PATH + 32], title[128], details[200];
    double high = picture_round_down(fmax(1e-4, w->farthest));
    picture p;
    picture_begin(&p, width, height);
    cut_scene_draw(&w->c, &p, w->distances, high);
    draw_grasper(w, &p);
    picture_render(&p, -28, 26);
    picture_colour_bar(&p, "from the tumour", "mm", 0, 1e3 * high, 1e3 * w->farthest);
    picture_length_bar(&p);
    snprintf(title, sizeof title, "%.1f ml resected, margin %.1f mm", 1e6 * (double)wedge->volume, 1e3 * w->margin);
    snprintf(details, sizeof details, "tumour of %.1f ml; %d %s, E %.4g kPa, lattice %d", 1e6 * w->volume,
             w->c.scene.mesh.element_count, sb_element_name(w->c.scene.mesh.element_type), 1e-3 * w->set->cut.young,
             w->set->cut.lattice);
    picture_text(&p, 0.06 * width, 0.075 * height, 22, PICTURE_LEFT, picture_ink(), title);
    picture_text(&p, 0.06 * width, 0.115 * height, 14, PICTURE_LEFT, picture_ink(), details);
    snprintf(path, sizeof path, "%s.png", w->set->cut.out);
    return organ_save_picture(&w->c.scene, &p, path);
}

static int print_summary(work *w)
{
    const sb_part *wedge = w->c.parts + w->wedge;
    double weight = (double)wedge->mass * gravity, carried = w->frames[w->frame_count - 1].carried;
    printf("organ       %s: %d nodes, %d %s, E %.4g Pa, tumour %.3g times\n",
           w->set->cut.organ ? w->set->cut.organ : "like a liver", w->c.scene.mesh.node_count,
           w->c.scene.mesh.element_count, sb_element_name(w->c.scene.mesh.element_type), w->set->cut.young,
           w->set->ratio);
    printf("tumour      %s, %.2f ml; %s\n", w->set->tumour ? w->set->tumour : "below the skin", 1e6 * w->volume,
           w->astray ? "the cut goes through it, or touches it" : "whole in the wedge");
    printf("margin      %.2f mm at rest, %.2f mm planned\n", 1e3 * w->margin, 1e3 * w->set->margin);
    cut_scene_print_parts(&w->c);
    printf("grasper     holds %d nodes of part %d, carries %.3f N of %.3f N\n", w->grip_count, w->wedge, carried,
           weight);
    printf("written     %s.csv, %s.png", w->set->cut.out, w->set->cut.out);
    if (w->c.scene.frames)
        printf(", %s_0000.vtk to _%04d.vtk and %s_tumour_...; ParaView opens %s.vtk.series", w->set->cut.out,
               w->c.scene.frames - 1, w->set->cut.out, w->set->cut.out);
    printf("\nparts=%d resected_ml=%.2f resected_g=%.2f tumour_ml=%.2f margin_mm=%.2f carried=%.4f\n", w->c.part_count,
           1e6 * (double)wedge->volume, 1e3 * (double)wedge->mass, 1e6 * w->volume, 1e3 * w->margin, carried / weight);
    return 0;
}

static void release(work *w)
{
    sb_embedding_destroy(w->inside);
    cut_scene_free(&w->c);
    sb_surface_destroy(w->shape);
    sb_mesh_free(&w->tumour);
    free(w->now);
    free(w->distances);
    free(w->grip);
    free(w->grip_at);
    free(w->frames);
}

static int run(const settings *set)
{
    static int (*const stages[])(work *) = {make_mesh,  make_tumour, stiffen_tumour, make_scene,   cut_wedge,
                                            grip_wedge, lift_wedge,  write_table,    draw_picture, print_summary};
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
    s.cut = cut_settings_default(program_name);
    s.cut.front = "lag";
    s.cut.young = 6000;
    s.ratio = 5;
    s.size = 0.012;
    s.depth = 0.024;
    s.x = 0.45, s.y = 0.4;
    s.margin = 0.008;
    s.angle = 38;
    s.lift = 0.08;
    return s;
}

enum { OPTION_COUNT = 10 }; /* of its own */
static int list_options(settings *s, option options[OPTION_COUNT + CUT_OPTION_COUNT])
{
    const option all[OPTION_COUNT] = {
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &s->cut.out, 0, 0, "files are NAME.csv, NAME.png"},
        {"--tumour", "FILE", OPTION_TEXT, NULL, NULL, &s->tumour, 0, 0,
         "a closed surface of triangles in the organ; without it one is made"},
        {"--margin", "M", OPTION_NUMBER, NULL, &s->margin, NULL, 0, 1, "of healthy tissue around the tumour (m)"},
        {"--angle", "DEG", OPTION_NUMBER, NULL, &s->angle, NULL, 10, 80, "of the wedge's sides from the vertical"},
        {"--lift", "M", OPTION_NUMBER, NULL, &s->lift, NULL, 0, 10, "how far the grasper lifts it (m)"},
        {"--size", "M", OPTION_NUMBER, NULL, &s->size, NULL, 1e-4, 1, "radius of the tumour that is made (m)"},
        {"--depth", "M", OPTION_NUMBER, NULL, &s->depth, NULL, 1e-4, 1, "of its middle below the skin (m)"},
        {"--x", "SHARE", OPTION_NUMBER, NULL, &s->x, NULL, 0, 1, "where it is in the organ's box"},
        {"--y", "SHARE", OPTION_NUMBER, NULL, &s->y, NULL, 0, 1, "likewise"},
        {"--ratio", "X", OPTION_NUMBER, NULL, &s->ratio, NULL, 0.01, 1e4, "how many times stiffer the tumour is"},
    };
    memcpy(options, all, sizeof all);
    return cut_options_add(&s->cut, options, OPTION_COUNT, "cut apart");
}

static int program(int argc, char **argv)
{
    settings s = default_settings();
    option options[OPTION_COUNT + CUT_OPTION_COUNT];
    int count = list_options(&s, options);
    if (!options_parse(program_name, options, count, &s.cut.organ, 1, argc, argv))
        return ORGAN_USAGE;
    if (s.cut.help) {
        s = default_settings();
        list_options(&s, options);
        printf("usage: cut_resect [ORGAN] [OPTIONS]\n\n"
               "A wedge with a tumour in it is cut out of an organ on a table and lifted out. ORGAN: a mesh of tet4 or "
               "tet10 in\n"
               "metres (VTK, VTU, gmsh, Medit or TetGen); without it one like a liver is made.\n\n");
        options_print(options, count);
        printf(
            "\nThe last line: parts, what was resected, the tumour, the least distance of what was laid open from it\n"
            "at rest, and what the grasper carries at the end over the wedge's weight.\n");
        return 0;
    }
    return cut_settings_check(program_name, &s.cut) ? run(&s) : ORGAN_USAGE;
}

int main(int argc, char **argv) { return finish(program_name, program(argc, argv), ORGAN_USAGE); }
