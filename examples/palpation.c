/* palpation: a probe presses an organ with a stiff tumour at the points of a grid, and says where the tumour is.
 *
 *     palpation [ORGAN] [OPTIONS]      palpation --help lists the options
 *
 * Without a file a slab of 100 x 100 x 40 mm is made. The tumour is a ball of stiffer tissue some way below the skin,
 * at a place given or drawn at random. What looks down is held, as on a table. At each point that can be reached from
 * above a round probe presses the same depth into the skin, along its normal, and the force is read. What differs from
 * a smooth background shows the tumour: a quadric fitted to the forces, less and less to those that stick out of it, or
 * with --healthy the forces of the same organ without it, which shows it on a curved organ too. Written are the forces
 * (CSV) and a picture of the map. Exit status: 0, 2 wrong usage or a file that cannot be read or written, 3 a step
 * failed or memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "options.h"
#include "organ_scene.h"

#define REAL(x) ((sb_real)(x)) /* everything here computes in double, the body in sb_real */

static const char *const program_name = "palpation";
static const double clear = 1e-4;         /* m, of the probe from the skin before */
static const double slow = 1;             /* s, of a step: so long that inertia and damping have no say */
static const double seen_contrast = 0.05; /* of the background: what a finger is said to feel */
static const double seen_noise = 4;       /* times what the rest of the map spreads by */
enum { SETTLING = 2, MOST_GRID = 60, FIT_TERMS = 6, FIT_ROUNDS = 12 };

typedef struct settings {
    const char *organ, *out;
    double scale, young, poisson, ratio, size, depth, x, y, indentation, probe;
    int grid, cells, seed, healthy, help;
} settings;

/* A point of the grid. */
typedef struct spot {
    int known;       /* 0: it cannot be reached */
    double u, v;     /* place in the map, from -1 to 1 */
    sb_vec3 at, out; /* m, on the skin; its normal */
    double force, background;
} spot;

typedef struct work {
    const settings *set;
    organ scene;
    int tool;
    double x, y, size, depth; /* of the tumour: shares of the organ's box, m, m */
    sb_vec3 entry, tumour;    /* m: on the skin above it; its middle */
    int tumour_cells;
    spot spots[MOST_GRID * MOST_GRID];
    int count; /* that are known */
    sb_vec3 low, high;
    /* result */
    sb_vec3 found;
    double contrast, noise, error;
    int seen;
} work;

/* ---- the organ ------------------------------------------------------------------------------------------------- */

static int make_mesh(work *w)
{
    const settings *s = w->set;
    int status;
    sb_error error;
    w->scene = organ_named(program_name);
    if (s->organ) {
        status = organ_load(&w->scene, s->organ, s->scale);
        return status ? status : organ_make_skin(&w->scene);
    }
    if (sb_mesh_beam(SB_TET4, s->cells, s->cells, (int)fmax(2, floor(0.4 * s->cells + 0.5)),
                     sb_v3(REAL(0.1), REAL(0.1), REAL(0.04)), NULL, &w->scene.mesh, &error) != SB_OK)
        return organ_complain_of(&w->scene, "the slab", &error, ORGAN_USAGE);
    return organ_make_skin(&w->scene);
}

/* The skin below (x, y), seen from above: where, its normal, and how thick the organ is there. 0: nothing is there. */
static int look_down(const organ *o, double x, double y, sb_vec3 *at, sb_vec3 *out, double *thickness)
{
    sb_real above = o->high.z + (o->high.z - o->low.z);
    sb_vec3 from = sb_v3(REAL(x), REAL(y), above);
    sb_surface_hit hit, below;
    if (!sb_surface_ray(o->skin, from, sb_v3(0, 0, -1), SB_REAL_MAX, &hit))
        return 0;
    *at = hit.point;
    *out = sb_surface_normal(o->skin, &hit);
    *thickness = 0;
    from.z = o->low.z - (o->high.z - o->low.z);
    if (sb_surface_ray(o->skin, from, sb_v3(0, 0, 1), SB_REAL_MAX, &below))
        *thickness = (double)(hit.point.z - below.point.z);
    return 1;
}

static sb_vec3 in_box(const organ *o, double x, double y)
{
    return sb_v3(o->low.x + REAL(x) * (o->high.x - o->low.x), o->low.y + REAL(y) * (o->high.y - o->low.y), 0);
}

/* Where the tumour is to be: as the options say, or anywhere that it fits below a skin that looks up. */
static int choose_place(work *w)
{
    const settings *s = w->set;
    unsigned long long seed = (unsigned long long)s->seed;
    w->x = s->x, w->y = s->y, w->size = s->size, w->depth = s->depth;
    for (int tries = 0; tries < 1000; tries++) {
        double thickness;
        sb_vec3 at, out;
        if (s->seed) {
            w->x = 0.2 + 0.6 * organ_chance(&seed);
            w->y = 0.2 + 0.6 * organ_chance(&seed);
            w->size = s->size * (0.8 + 0.5 * organ_chance(&seed));
            w->depth = s->depth * (0.8 + 0.4 * organ_chance(&seed));
        }
        at = in_box(&w->scene, w->x, w->y);
        if (look_down(&w->scene, (double)at.x, (double)at.y, &at, &out, &thickness) && thickness > w->depth + w->size &&
            (!s->seed || out.z > REAL(0.8))) {
            w->entry = at;
            w->tumour = sb_v3_madd(at, REAL(-w->depth), out);
            return 0;
        }
        if (!s->seed)
            break;
    }
    return organ_complain(&w->scene, "the tumour", "has no room there: choose another place, --size or --depth",
                          ORGAN_USAGE);
}

static sb_vec3 element_middle(const sb_mesh *mesh, int element)
{
    int corners = sb_element_corner_count(mesh->element_type), width = sb_mesh_element_width(mesh);
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int a = 0; a < corners; a++)
        sum = sb_v3_add(sum, mesh->nodes[mesh->elements[(size_t)element * (size_t)width + (size_t)a]]);
    return sb_v3_scale(REAL(1.0 / corners), sum);
}

/* Elements whose middle is in the tumour become a region of their own. */
static int plant_tumour(work *w)
{
    sb_mesh *mesh = &w->scene.mesh;
    int status = choose_place(w);
    if (status)
        return status;
    if (!mesh->regions)
        mesh->regions = (int *)malloc((size_t)mesh->element_count * sizeof(int));
    if (!mesh->regions)
        return organ_complain_memory(&w->scene);
    for (int e = 0; e < mesh->element_count; e++) {
        mesh->regions[e] = (double)sb_v3_norm(sb_v3_sub(element_middle(mesh, e), w->tumour)) < w->size;
        w->tumour_cells += mesh->regions[e];
    }
    if (w->tumour_cells == 0)
        return organ_complain(&w->scene, "the tumour", "is smaller than an element: take a larger --size", ORGAN_USAGE);
    return 0;
}

static int make_scene(work *w)
{
    const settings *s = w->set;
    const double density = 1000; /* kg/m^3 */
    sb_body_def body = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    sb_tool_def probe = sb_default_tool_def();
    sb_region_material stiff;
    int status;
    stiff.region = 1;
    stiff.material = sb_material_corotated(REAL(s->young * s->ratio), REAL(s->poisson), REAL(density));
    body.material = sb_material_corotated(REAL(s->young), REAL(s->poisson), REAL(density));
    body.region_materials = &stiff;
    body.region_material_count = 1;
    body.gravity = sb_v3(0, 0, 0);
    body.tolerance = REAL(3e-3);
    body.max_iterations = 5000;
    contact.max_iterations = 8;
    status = organ_make_body(&w->scene, &body, &contact);
    if (!status)
        status = organ_hold_on_table(&w->scene);
    probe.radius = REAL(s->probe);
    probe.pose.position = sb_v3(w->scene.low.x, w->scene.low.y, w->scene.high.z + REAL(10 * s->probe));
    return status ? status : organ_add_tool(&w->scene, &probe, &w->tool);
}

/* Points that a probe reaches from above, on tissue that is thick enough and not held. */
static int lay_grid(work *w)
{
    const organ *o = &w->scene;
    int n = w->set->grid;
    for (int i = 0; i < n * n; i++) {
        spot *p = w->spots + i;
        double thickness, margin = 0.08;
        sb_vec3 at;
        p->u = 2.0 * (i % n) / (n - 1) - 1;
        p->v = 2.0 * (int)(i / n) / (n - 1) - 1;
        at = in_box(o, 0.5 + (0.5 - margin) * p->u, 0.5 + (0.5 - margin) * p->v);
        p->known = look_down(o, (double)at.x, (double)at.y, &p->at, &p->out, &thickness) && p->out.z > REAL(0.6) &&
                   thickness > 4 * w->set->indentation;
        w->count += p->known;
    }
    return w->count > 2 * FIT_TERMS ? 0
                                    : organ_complain(o, "the grid", "has too few points above the organ", ORGAN_USAGE);
}

/* ---- pressing -------------------------------------------------------------------------------------------------- */

static sb_pose probe_at(const work *w, const spot *p, double depth)
{
    sb_pose pose;
    pose.position = sb_v3_madd(p->at, REAL(w->set->probe - depth), p->out);
    pose.rotation = sb_quat_identity();
    return pose;
}

/* Presses there, on the organ at rest; *force (N) along the normal. */
static int press(work *w, const spot *p, double *force)
{
    int strides = (int)ceil((w->set->indentation + clear) / (0.45 * w->set->probe)), status = 0;
    sb_pose pose = probe_at(w, p, -clear);
    sb_wrench wrench;
    sb_error error;
    sb_body_reset(w->scene.body);
    if (sb_contact_place_tool(w->scene.contact, w->tool, &pose, &error) != SB_OK)
        return organ_complain_of(&w->scene, "the probe", &error, ORGAN_FAILED);
    for (int i = 1; i <= strides + SETTLING && !status; i++) {
        pose = probe_at(w, p, w->set->indentation * (i < strides ? i : strides) / strides);
        sb_contact_move_tool(w->scene.contact, w->tool, &pose);
        status = organ_step(&w->scene, slow);
    }
    sb_contact_wrench(w->scene.contact, w->tool, &wrench);
    *force = (double)sb_v3_dot(wrench.force, p->out);
    return status;
}

static int press_all(work *w, int healthy)
{
    int status = 0, done = 0;
    for (int i = 0; i < w->set->grid * w->set->grid && !status; i++) {
        spot *p = w->spots + i;
        char words[64];
        if (!p->known)
            continue;
        status = press(w, p, healthy ? &p->background : &p->force);
        snprintf(words, sizeof words, "point %d of %d%s", ++done, w->count, healthy ? ", healthy" : "");
        progress_show((double)done / w->count, words);
    }
    progress_end();
    return status;
}

static int map_forces(work *w)
{
    const settings *s = w->set;
    int status = press_all(w, 0);
    sb_material healthy = sb_material_corotated(REAL(s->young), REAL(s->poisson), 1000);
    sb_error error;
    if (status || !s->healthy)
        return status;
    if (sb_body_set_region_material(w->scene.body, 1, &healthy, &error) != SB_OK)
        return organ_complain_of(&w->scene, "the organ", &error, ORGAN_FAILED);
    return press_all(w, 1);
}

/* ---- finding --------------------------------------------------------------------------------------------------- */

static void fit_terms(const spot *p, double terms[FIT_TERMS])
{
    terms[0] = 1, terms[1] = p->u, terms[2] = p->v;
    terms[3] = p->u * p->u, terms[4] = p->u * p->v, terms[5] = p->v * p->v;
}

/* Solves the normal equations m [FIT_TERMS][FIT_TERMS + 1] in place: positive definite, so without pivoting. */
static void fit_solve(double m[FIT_TERMS][FIT_TERMS + 1], double answer[FIT_TERMS])
{
    for (int j = 0; j < FIT_TERMS; j++)
        for (int i = 0; i < FIT_TERMS; i++)
            for (int k = FIT_TERMS; i != j && k >= j; k--)
                m[i][k] -= m[i][j] / m[j][j] * m[j][k];
    for (int j = 0; j < FIT_TERMS; j++)
        answer[j] = m[j][FIT_TERMS] / m[j][j];
}

/* Spread of what differs from the background: as large as the standard deviation of even noise, whatever sticks out. */
static double spread(const work *w)
{
    double off[MOST_GRID * MOST_GRID];
    int count = 0;
    for (int i = 0; i < w->set->grid * w->set->grid; i++)
        if (w->spots[i].known)
            off[count++] = fabs(w->spots[i].force - w->spots[i].background);
    return 1.4826 * organ_median(off, count);
}

/* A quadric through the forces, in rounds in which what sticks out counts ever less (Tukey's biweight). */
static void fit_background(work *w)
{
    int all = w->set->grid * w->set->grid;
    for (int round = 0; round < FIT_ROUNDS; round++) {
        double m[FIT_TERMS][FIT_TERMS + 1] = {{0}}, answer[FIT_TERMS], limit = round ? 4.685 * spread(w) : HUGE_VAL;
        for (int i = 0; i < all; i++) {
            const spot *p = w->spots + i;
            double terms[FIT_TERMS], off = round ? (p->force - p->background) / limit : 0;
            double weight = fabs(off) < 1 ? (1 - off * off) * (1 - off * off) : 1e-6;
            fit_terms(p, terms);
            for (int j = 0; p->known && j < FIT_TERMS; j++) {
                for (int k = 0; k < FIT_TERMS; k++)
                    m[j][k] += weight * terms[j] * terms[k];
                m[j][FIT_TERMS] += weight * terms[j] * p->force;
            }
        }
        fit_solve(m, answer);
        for (int i = 0; i < all; i++) {
            double terms[FIT_TERMS];
            fit_terms(w->spots + i, terms);
            w->spots[i].background = 0;
            for (int j = 0; j < FIT_TERMS; j++)
                w->spots[i].background += answer[j] * terms[j];
        }
    }
}

static double excess(const spot *p) { return p->known ? p->force - p->background : 0; }

/* Mean excess of a point and its neighbours, the point itself counting as much as two of them. */
static double smooth_excess(const work *w, int i)
{
    int n = w->set->grid, x = i % n, y = i / n;
    double sum = 0, weights = 0;
    for (int dy = -1; dy <= 1; dy++)
        for (int dx = -1; dx <= 1; dx++) {
            int a = x + dx, b = y + dy;
            double weight = (dx ? 1 : 2) * (dy ? 1 : 2);
            if (a < 0 || b < 0 || a >= n || b >= n || !w->spots[b * n + a].known)
                continue;
            sum += weight * excess(w->spots + b * n + a);
            weights += weight;
        }
    return weights > 0 ? sum / weights : 0;
}

/* The place that sticks out most, and the middle of what sticks out half as much around it. */
static int find_tumour(work *w)
{
    int n = w->set->grid, best = -1;
    double most = 0, weights = 0;
    sb_vec3 sum = sb_v3(0, 0, 0);
    if (!w->set->healthy)
        fit_background(w);
    for (int i = 0; i < n * n; i++)
        if (w->spots[i].known && (best < 0 || smooth_excess(w, i) > most))
            most = smooth_excess(w, best = i);
    for (int i = 0; i < n * n; i++) {
        double weight = smooth_excess(w, i) - 0.5 * most;
        if (!w->spots[i].known || !(weight > 0) || abs(i % n - best % n) > n / 5 + 1 ||
            abs(i / n - best / n) > n / 5 + 1)
            continue;
        sum = sb_v3_madd(sum, REAL(weight), w->spots[i].at);
        weights += weight;
    }
    w->found = weights > 0 ? sb_v3_scale(REAL(1 / weights), sum) : w->spots[best].at;
    w->contrast = excess(w->spots + best) / w->spots[best].background;
    w->noise = spread(w) > 0 ? most / spread(w) : 0;
    w->error = hypot((double)(w->found.x - w->entry.x), (double)(w->found.y - w->entry.y));
    w->seen = w->contrast > seen_contrast && w->noise > seen_noise;
    return 0;
}

/* ---- what is written ------------------------------------------------------------------------------------------- */

static int write_table(work *w)
{
    char path[ORGAN_PATH + 32];
    sb_output out;
    snprintf(path, sizeof path, "%s.csv", w->set->out);
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return organ_complain_file(&w->scene, path);
    fprintf(out.file, "x_mm,y_mm,z_mm,force_N,background_N\n");
    for (int i = 0; i < w->set->grid * w->set->grid; i++) {
        const spot *p = w->spots + i;
        if (p->known)
            fprintf(out.file, "%.4g,%.4g,%.4g,%.6g,%.6g\n", 1e3 * (double)p->at.x, 1e3 * (double)p->at.y,
                    1e3 * (double)p->at.z, p->force, p->background);
    }
    return sb_output_close(&out, NULL) == SB_OK ? 0 : organ_complain_file(&w->scene, path);
}

/* Force at a place of the skin, from the points around it; 0 where none is near. */
static double force_at(const work *w, sb_vec3 at)
{
    int n = w->set->grid;
    double reach =
        1.1 * fmax((double)(w->scene.high.x - w->scene.low.x), (double)(w->scene.high.y - w->scene.low.y)) / n;
    double sum = 0, weights = 0;
    for (int i = 0; i < n * n; i++) {
        double distance = w->spots[i].known ? (double)sb_v3_norm(sb_v3_sub(at, w->spots[i].at)) / reach : 1;
        double weight = distance < 1 ? (1 - distance) * (1 - distance) : 0;
        sum += weight * w->spots[i].force;
        weights += weight;
    }
    return weights > 0 ? sum / weights : 0;
}

static void draw_pin(picture *p, const work *w, sb_vec3 at, unsigned colour)
{
    double size = (double)sb_v3_norm(sb_v3_sub(w->scene.high, w->scene.low));
    sb_vec3 top = sb_v3(at.x, at.y, at.z + REAL(0.09 * size));
    picture_add_capsule(p, at, top, 0.004 * size, picture_web(colour));
    picture_add_capsule(p, top, top, 0.012 * size, picture_web(colour));
}

static int draw_picture(work *w)
{
    const int width = 1280, height = 960;
    char path[ORGAN_PATH + 32], title[128], details[200];
    double least = HUGE_VAL, most = 0, step, high;
    picture p;
    for (int i = 0; i < w->set->grid * w->set->grid; i++)
        if (w->spots[i].known) {
            least = fmin(least, w->spots[i].force);
            most = fmax(most, w->spots[i].force);
        }
    step = most > least ? picture_round_down((most - least) / 3) : 1; /* the map's ends are round numbers */
    least = step * floor(least / step);
    high = step * ceil(most / step);
    for (int i = 0; i < w->scene.mesh.node_count; i++) {
        double force = force_at(w, w->scene.mesh.nodes[i]);
        w->scene.numbers[i] = REAL(fmax(0, force - least));
    }
    picture_begin(&p, width, height);
    organ_draw(&w->scene, &p, w->scene.mesh.nodes, w->scene.numbers, high - least);
    draw_pin(&p, w, w->entry, 0x009e73);
    draw_pin(&p, w, w->found, 0x0072b2);
    picture_render(&p, 20, 55);
    picture_colour_bar(&p, "force", "N", least, high, most);
    picture_length_bar(&p);
    snprintf(title, sizeof title, "Pressed %.1f mm deep: found %.1f mm off, contrast %.0f %%",
             1e3 * w->set->indentation, 1e3 * w->error, 100 * w->contrast);
    snprintf(details, sizeof details, "green: the tumour, %.0f mm wide, %.0f mm deep, %.3g times as stiff; blue: found",
             2e3 * w->size, 1e3 * w->depth, w->set->ratio);
    picture_text(&p, 0.06 * width, 0.075 * height, 22, PICTURE_LEFT, picture_ink(), title);
    picture_text(&p, 0.06 * width, 0.115 * height, 14, PICTURE_LEFT, picture_ink(), details);
    snprintf(path, sizeof path, "%s.png", w->set->out);
    return organ_save_picture(&w->scene, &p, path);
}

static int print_summary(work *w)
{
    printf("organ       %s: %d nodes, %d %s, E %.4g Pa\n", w->set->organ ? w->set->organ : "a slab",
           w->scene.mesh.node_count, w->scene.mesh.element_count, sb_element_name(w->scene.mesh.element_type),
           w->set->young);
    printf("tumour      %.1f mm wide, %.1f mm deep at (%.1f, %.1f) mm, %.3g times as stiff, %d elements\n",
           2e3 * w->size, 1e3 * w->depth, 1e3 * (double)w->entry.x, 1e3 * (double)w->entry.y, w->set->ratio,
           w->tumour_cells);
    printf("found       at (%.1f, %.1f) mm, %s\n", 1e3 * (double)w->found.x, 1e3 * (double)w->found.y,
           w->seen ? "clearly" : "but it hardly sticks out");
    printf("written     %s.csv, %s.png\n", w->set->out, w->set->out);
    printf("seen=%d error_mm=%.2f contrast=%.3f over_noise=%.1f points=%d\n", w->seen, 1e3 * w->error, w->contrast,
           w->noise, w->count);
    return 0;
}

static int run(const settings *set)
{
    static int (*const stages[])(work *) = {make_mesh,   plant_tumour, make_scene,   lay_grid,     map_forces,
                                            find_tumour, write_table,  draw_picture, print_summary};
    work *w = (work *)calloc(1, sizeof *w);
    int status = 0;
    if (!w) {
        fprintf(stderr, "palpation: out of memory\n");
        return ORGAN_FAILED;
    }
    w->set = set;
    for (size_t i = 0; i < sizeof stages / sizeof stages[0] && !status; i++)
        status = stages[i](w);
    organ_free(&w->scene);
    free(w);
    return status;
}

/* ---- command line ---------------------------------------------------------------------------------------------- */

static settings default_settings(void)
{
    settings s;
    memset(&s, 0, sizeof s);
    s.out = program_name;
    s.scale = 1;
    s.young = 5000;
    s.poisson = 0.45;
    s.ratio = 10;
    s.size = 0.008;
    s.depth = 0.013;
    s.x = 0.65, s.y = 0.4;
    s.indentation = 0.004;
    s.probe = 0.006;
    s.grid = 11;
    s.cells = 16;
    return s;
}

enum { OPTION_COUNT = 17 };
static void list_options(settings *s, option options[OPTION_COUNT])
{
    const option all[OPTION_COUNT] = {
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &s->out, 0, 0, "files are NAME.csv and NAME.png"},
        {"--scale", "X", OPTION_NUMBER, NULL, &s->scale, NULL, 1e-9, 1e9,
         "multiplies the file's lengths; 0.001 for millimetres"},
        {"--young", "PA", OPTION_NUMBER, NULL, &s->young, NULL, 1, 1e9, "Young's modulus of the organ (Pa)"},
        {"--poisson", "NU", OPTION_NUMBER, NULL, &s->poisson, NULL, 0, 0.49, "Poisson's ratio"},
        {"--ratio", "X", OPTION_NUMBER, NULL, &s->ratio, NULL, 0.01, 1e3, "how many times as stiff the tumour is"},
        {"--size", "M", OPTION_NUMBER, NULL, &s->size, NULL, 1e-4, 1, "radius of the tumour (m)"},
        {"--depth", "M", OPTION_NUMBER, NULL, &s->depth, NULL, 1e-4, 1, "of its middle below the skin (m)"},
        {"--x", "SHARE", OPTION_NUMBER, NULL, &s->x, NULL, 0, 1, "its place, as a share of the organ's width"},
        {"--y", "SHARE", OPTION_NUMBER, NULL, &s->y, NULL, 0, 1, "and of its length"},
        {"--seed", "N", OPTION_INTEGER, &s->seed, NULL, NULL, 0, 1e6,
         "place at random, size and depth about those given; 0 (default): as given"},
        {"--indent", "M", OPTION_NUMBER, NULL, &s->indentation, NULL, 1e-5, 0.1, "how deep the probe presses (m)"},
        {"--probe", "M", OPTION_NUMBER, NULL, &s->probe, NULL, 1e-4, 0.1, "radius of the probe (m)"},
        {"--grid", "N", OPTION_INTEGER, &s->grid, NULL, NULL, 5, MOST_GRID, "points along each side of the map"},
        {"--cells", "N", OPTION_INTEGER, &s->cells, NULL, NULL, 4, 60, "of the slab along each side"},
        {"--healthy", NULL, OPTION_FLAG, &s->healthy, NULL, NULL, 0, 0,
         "compare with the same organ without the tumour"},
        {"--help", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, "this text"},
        {"-h", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, NULL},
    };
    memcpy(options, all, sizeof all);
}

static int check_settings(const settings *s)
{
    if (!organ_check_name(program_name, "-o", s->out))
        return 0;
    if (!(s->indentation < 2 * s->probe))
        return options_complain(program_name, "--indent", "needs to be less than the probe's diameter");
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
        printf("usage: palpation [ORGAN] [OPTIONS]\n\n"
               "A probe presses an organ with a stiff tumour at the points of a grid, and says where the tumour is.\n"
               "ORGAN: a volume mesh in metres (VTK, VTU, gmsh, Medit or TetGen) that lies on what looks down;\n"
               "without it a slab is made.\n\n");
        options_print(options, OPTION_COUNT);
        printf(
            "\nThe last line: whether the tumour was seen (%.0f %% above the background and %.0f times what the map\n"
            "spreads by), how far off it was found, how much it sticks out, both ways, and how many points were\n"
            "pressed.\n",
            100 * seen_contrast, seen_noise);
        return 0;
    }
    return check_settings(&s) ? run(&s) : ORGAN_USAGE;
}

int main(int argc, char **argv) { return finish(program_name, program(argc, argv), ORGAN_USAGE); }
