/* track_liver: follows a breathing liver scan by scan, 30 times a second, and shows how far off it is.
 *
 *     track_liver [ORGAN] [OPTIONS]      track_liver --help lists the options
 *
 * Without a file a liver-like organ is made, twice: a fine one of tet10 and another law that breathes, and a coarse one
 * of tet4 that is the model; of a file both are made of its mesh. It hangs at its back, is pushed down at its top and
 * goes up and down as a whole. A camera above it sees points of its surface, with noise; a tool whose shadow goes to
 * and fro hides some, and now and then the camera sees nothing. With --landmarks and --curves points and lines of the
 * organ are seen beside the surface, on it or inside (as by ultrasound), wherever they are. Written are the course
 * (CSV) and a chart (SVG): the true error inside the organ beside the one that the tracker expects, and the time of
 * each frame. Exit status: 0, 2 wrong usage or a file that cannot be read or written, 3 a computation failed or memory
 * is short, 4 the organ was lost at the end. */
#include "system.h"

#define SB_IMPLEMENTATION
#define REG_IMPLEMENTATION
#include "register.h"

#include "options.h"
#include "organ_scene.h"
#include "plot.h"
#include "rows.h"

#define REAL(x) ((sb_real)(x)) /* everything here computes in double, the body in sb_real */

static const char *const program_name = "track_liver";
static const double pi = 3.14159265358979;
enum { PHASES = 4, MOST_FRAMES = 20000, STATUS_LOST = 4 };

typedef struct settings {
    const char *organ, *out, *landmarks, *curves;
    double scale, breath, push, period, noise, rate, seconds, shadow, drop, drop_every;
    int points, cells, modes, seed, help;
} settings;

/* What a frame ended with: s, m, ms. */
typedef struct moment {
    double time, error, expected, milliseconds;
    int state;
} moment;

typedef struct work {
    const settings *set;
    organ real;                /* that breathes */
    sb_mesh model_mesh;        /* of what is known of it */
    sb_vec3 *phase[PHASES];    /* [nodes of real] displacements at 0, 1/3, 2/3 and all of a breath (m) */
    sb_vec3 *now, *guess;      /* [nodes of real] where they are, and where the tracker has them (m) */
    sb_vec3 *displacements;    /* [nodes of the model] */
    sb_vec3 *points, *normals; /* [points]; [surface nodes of real] */
    sb_embedding_rows rows;    /* of real's nodes in the model */
    sb_vec3 *marks, *seen;     /* [mark_count] m: landmarks, then corners of curves: at rest, where they are seen now */
    sb_embedding_rows held;    /* of these in real */
    reg_landmark *landmarks;   /* [landmark_count] */
    reg_curve *curves;         /* [curve_count] */
    int mark_count, landmark_count, curve_count;
    reg_model *model;
    reg_track *track;
    moment *moments; /* [frames] */
    int frames;
} work;

static int complain_of(const work *w, const char *about, const sb_error *error)
{
    return organ_complain_of(&w->real, about, error, ORGAN_FAILED);
}

/* ---- the organ that breathes ----------------------------------------------------------------------------------- */

static int make_meshes(work *w)
{
    const settings *s = w->set;
    sb_error error;
    sb_result result;
    int status = 0;
    w->real = organ_named(program_name);
    if (s->organ) {
        status = organ_load(&w->real, s->organ, s->scale);
        if (status)
            return status;
        result = sb_mesh_copy(&w->real.mesh, NULL, &w->model_mesh, &error);
    } else {
        result = sb_mesh_organ(SB_TET10, (int)fmax(10, 0.7 * s->cells), NULL, &w->real.mesh, &error);
        if (result == SB_OK)
            result = sb_mesh_organ(SB_TET4, s->cells, NULL, &w->model_mesh, &error);
    }
    return result == SB_OK ? organ_make_skin(&w->real) : complain_of(w, "the organ", &error);
}

/* 0, or a complaint about what the organ cannot do, or is too much to write. */
static int check_course(const work *w)
{
    const organ *o = &w->real;
    const settings *s = w->set;
    if (s->seconds * s->rate > (int)MOST_FRAMES)
        return organ_complain(o, "--seconds", "that long at this --rate is more than 20,000 frames", ORGAN_USAGE);
    if (s->push > 0.5 * (double)(o->high.z - o->low.z))
        return organ_complain(o, "--push", "the top would be pushed through half of the organ", ORGAN_USAGE);
    return 0;
}

/* Holds the back, and moves the top down by a share of the push. */
static int set_supports(work *w, double share)
{
    const organ *o = &w->real;
    double height = (double)(o->high.z - o->low.z), depth = (double)(o->high.y - o->low.y);
    for (int i = 0; i < o->boundary.surface.node_count; i++) {
        int node = o->boundary.nodes[i];
        sb_vec3 x = o->mesh.nodes[node], way = sb_v3(0, 0, REAL(-share * w->set->push));
        int back = (double)(o->high.y - x.y) < 0.15 * depth, top = (double)(o->high.z - x.z) < 0.15 * height;
        if (back && sb_body_fix_nodes(o->body, &node, 1, SB_XYZ) != SB_OK)
            return organ_complain_memory(o);
        if (top && !back && sb_body_prescribe(o->body, &node, 1, SB_XYZ, &way, 1) != SB_OK)
            return organ_complain_memory(o);
    }
    return 0;
}

/* The shapes of a breath, each in balance. */
static int breathe_in(work *w)
{
    organ *o = &w->real;
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    sb_error error;
    int status = 0;
    def.mesh = &o->mesh;
    def.material = sb_material_mooney_rivlin(525, 225, REAL(1.1e-4), 1060);
    options.tolerance = REAL(1e-3);
    if (sb_body_create(&def, &o->body, &error) != SB_OK)
        return complain_of(w, "the organ", &error);
    for (int k = 0; k < PHASES && !status; k++) {
        size_t bytes = (size_t)o->mesh.node_count * sizeof(sb_vec3);
        w->phase[k] = (sb_vec3 *)malloc(bytes);
        if (!w->phase[k])
            return organ_complain_memory(o);
        status = set_supports(w, (double)k / (PHASES - 1));
        if (!status && k > 0 && sb_body_solve_static(o->body, &options, &info) != SB_OK)
            status = complain_of(w, "the organ cannot breathe like this", &info.error);
        memcpy(w->phase[k], sb_body_displacements(o->body), bytes);
    }
    return status;
}

/* now: where the organ is at a time. */
static void move_organ(work *w, double time)
{
    const organ *o = &w->real;
    double share = 0.5 - 0.5 * cos(2 * pi * time / w->set->period), weight[PHASES];
    sb_vec3 middle = sb_v3_scale(REAL(0.5), sb_v3_add(o->low, o->high)),
            down = sb_v3(0, 0, REAL(-share * w->set->breath));
    sb_mat3 turn = sb_quat_to_mat3(sb_quat_from_rotation_vector(sb_v3(REAL(0.08 * share), REAL(0.03 * share), 0)));
    for (int k = 0; k < PHASES; k++) { /* Lagrange's */
        weight[k] = 1;
        for (int l = 0; l < PHASES; l++)
            weight[k] *= l == k ? 1 : (share * (PHASES - 1) - l) / (k - l);
    }
    for (int i = 0; i < o->mesh.node_count; i++) {
        sb_vec3 x = sb_v3_sub(o->mesh.nodes[i], middle);
        for (int k = 0; k < PHASES; k++)
            x = sb_v3_madd(x, REAL(weight[k]), w->phase[k][i]);
        w->now[i] = sb_v3_add(sb_v3_add(middle, down), sb_m3_apply(turn, x));
    }
}

/* ---- the camera ------------------------------------------------------------------------------------------------ */

/* Of mean 0 and deviation 1: twelve even numbers. */
static double normal_chance(unsigned long long *seed)
{
    double sum = -6;
    for (int i = 0; i < 12; i++)
        sum += organ_chance(seed);
    return sum;
}

static void find_normals(work *w)
{
    const sb_mesh *skin = &w->real.boundary.surface;
    int width = sb_mesh_element_width(skin);
    memset(w->normals, 0, (size_t)skin->node_count * sizeof *w->normals);
    for (int e = 0; e < skin->element_count; e++) {
        const int *c = skin->elements + (size_t)e * (size_t)width;
        sb_vec3 a = w->now[w->real.boundary.nodes[c[0]]], b = w->now[w->real.boundary.nodes[c[1]]],
                d = w->now[w->real.boundary.nodes[c[2]]];
        sb_vec3 normal = sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(d, a));
        for (int k = 0; k < width; k++)
            w->normals[c[k]] = sb_v3_add(w->normals[c[k]], normal);
    }
}

/* points: of the surface that looks up and is not in the tool's shadow, a strip across. Returns how many. */
static int scan(work *w, double time, unsigned long long *seed)
{
    const organ *o = &w->real;
    double middle = 0.5 + 0.35 * sin(2 * pi * time / 2.7), long_way = (double)(o->high.x - o->low.x);
    int made = 0, nodes = o->boundary.surface.node_count;
    find_normals(w);
    for (int tries = 0; tries < 50 * w->set->points && made < w->set->points; tries++) {
        int i = (int)(organ_chance(seed) * nodes) % nodes;
        sb_vec3 x = w->now[o->boundary.nodes[i]];
        double along = ((double)(x.x - o->low.x) / long_way - middle) * long_way;
        if (w->normals[i].z <= 0 || fabs(along) < 0.5 * w->set->shadow)
            continue;
        w->points[made++] =
            sb_v3_add(x, sb_v3(REAL(w->set->noise * normal_chance(seed)), REAL(w->set->noise * normal_chance(seed)),
                               REAL(w->set->noise * normal_chance(seed))));
    }
    return made;
}

/* ---- landmarks and curves --------------------------------------------------------------------------------------- */

static sb_vec3 mark_of(const work *w, const double *values)
{
    const double scale = w->set->scale;
    return sb_v3(REAL(scale * values[0]), REAL(scale * values[1]), REAL(scale * values[2]));
}

/* Curves of the table, whose rows are `c x y z`, c from 0 on and in order; their corners go behind the marks. */
static int take_curves(work *w, const rows *table)
{
    const char *path = w->set->curves;
    for (int i = 0; i < table->count; i++) {
        const row *item = table->items + i;
        int starts = item->values[0] == w->curve_count;
        if (!starts && item->values[0] != w->curve_count - 1)
            return rows_complain(program_name, path, item->line, "not `c x y z`, c from 0 on and in order");
        if (starts)
            w->curves[w->curve_count++].model = w->marks + w->mark_count;
        w->curves[w->curve_count - 1].model_count++;
        w->marks[w->mark_count++] = mark_of(w, item->values + 1);
    }
    for (int c = 0; c < w->curve_count; c++)
        if (w->curves[c].model_count < 2)
            return rows_complain(program_name, path, 0, "a line needs two corners");
    return 0;
}

static int take_marks(work *w, const rows *points, const rows *corners)
{
    size_t all = (size_t)points->count + (size_t)corners->count + 1;
    w->marks = (sb_vec3 *)calloc(all, sizeof(sb_vec3));
    w->seen = (sb_vec3 *)calloc(all, sizeof(sb_vec3));
    w->landmarks = (reg_landmark *)calloc((size_t)points->count + 1, sizeof(reg_landmark));
    w->curves = (reg_curve *)calloc((size_t)corners->count + 1, sizeof(reg_curve));
    if (!w->marks || !w->seen || !w->landmarks || !w->curves)
        return organ_complain_memory(&w->real);
    for (int i = 0; i < points->count; i++)
        w->marks[w->mark_count++] = w->landmarks[w->landmark_count++].model = mark_of(w, points->items[i].values);
    return take_curves(w, corners);
}

/* Where the marks are in the organ that breathes. */
static int hold_marks(work *w)
{
    sb_embedding_def embed = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_error error;
    sb_result result;
    embed.mesh = &w->real.mesh;
    embed.points = w->marks;
    embed.point_count = w->mark_count;
    embed.kind = SB_EMBED_PLAIN;
    embed.max_distance = REAL(0.05) * sb_v3_norm(sb_v3_sub(w->real.high, w->real.low));
    result = sb_embedding_create(&embed, &embedding, &error);
    if (result == SB_OK)
        result = sb_embedding_mapping(embedding, NULL, &w->held, &error);
    sb_embedding_destroy(embedding);
    return result == SB_OK ? 0
                           : organ_complain_of(&w->real, w->set->landmarks ? w->set->landmarks : w->set->curves, &error,
                                               ORGAN_USAGE);
}

static int load_marks(work *w)
{
    const settings *s = w->set;
    rows points, corners;
    int status = 0;
    memset(&points, 0, sizeof points);
    memset(&corners, 0, sizeof corners);
    if (s->landmarks)
        status = rows_read(program_name, s->landmarks, 1u << 3, "not `x y z`", &points);
    if (!status && s->curves)
        status = rows_read(program_name, s->curves, 1u << 4, "not `c x y z`", &corners);
    if (!status)
        status = take_marks(w, &points, &corners);
    if (!status && w->mark_count > 0)
        status = hold_marks(w);
    free(points.items);
    free(corners.items);
    return status;
}

/* Where the marks are seen, with noise. */
static void see_marks(work *w, unsigned long long *seed)
{
    sb_real sd = REAL(fmax(w->set->noise, 1e-4));
    if (w->mark_count > 0)
        sb_mapping_apply(&w->held.mapping, w->now, w->seen);
    for (int i = 0; i < w->mark_count; i++)
        w->seen[i] = sb_v3_add(w->seen[i], sb_v3(REAL(w->set->noise * normal_chance(seed)),
                                                 REAL(w->set->noise * normal_chance(seed)),
                                                 REAL(w->set->noise * normal_chance(seed))));
    for (int i = 0; i < w->landmark_count; i++) {
        w->landmarks[i].seen = w->seen[i];
        w->landmarks[i].sd = sd;
    }
    for (int i = 0; i < w->curve_count; i++) {
        w->curves[i].seen = w->seen + (w->curves[i].model - w->marks);
        w->curves[i].seen_count = w->curves[i].model_count;
        w->curves[i].sd = sd;
    }
}

/* ---- tracking -------------------------------------------------------------------------------------------------- */

static int make_tracker(work *w)
{
    reg_model_def model = reg_default_model_def();
    reg_track_def def = reg_default_track_def();
    sb_embedding_def embed = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_error error;
    sb_result result;
    model.mesh = &w->model_mesh;
    result = reg_model_create(&model, &w->model, &error);
    def.model = w->model;
    def.modes = w->set->modes;
    def.most_points = w->set->points;
    def.landmarks = w->landmarks;
    def.landmark_count = w->landmark_count;
    def.curves = w->curves;
    def.curve_count = w->curve_count;
    def.clock = seconds_now;
    if (result == SB_OK)
        result = reg_track_create(&def, &w->track, &error);
    embed.mesh = &w->model_mesh;
    embed.points = w->real.mesh.nodes;
    embed.point_count = w->real.mesh.node_count;
    embed.kind = SB_EMBED_PLAIN;
    embed.max_distance = sb_v3_norm(sb_v3_sub(w->real.high, w->real.low));
    if (result == SB_OK)
        result = sb_embedding_create(&embed, &embedding, &error);
    if (result == SB_OK)
        result = sb_embedding_mapping(embedding, NULL, &w->rows, &error);
    sb_embedding_destroy(embedding);
    return result == SB_OK ? 0 : complain_of(w, "the model", &error);
}

static int make_arrays(work *w)
{
    size_t nodes = (size_t)w->real.mesh.node_count, skin = (size_t)w->real.boundary.surface.node_count;
    w->frames = (int)floor(w->set->seconds * w->set->rate + 0.5);
    w->now = (sb_vec3 *)malloc(nodes * sizeof(sb_vec3));
    w->guess = (sb_vec3 *)malloc(nodes * sizeof(sb_vec3));
    w->displacements = (sb_vec3 *)malloc((size_t)w->model_mesh.node_count * sizeof(sb_vec3));
    w->points = (sb_vec3 *)malloc((size_t)w->set->points * sizeof(sb_vec3));
    w->normals = (sb_vec3 *)malloc(skin * sizeof(sb_vec3));
    w->moments = (moment *)calloc((size_t)w->frames, sizeof(moment));
    return w->now && w->guess && w->displacements && w->points && w->normals && w->moments
               ? 0
               : organ_complain_memory(&w->real);
}

/* Mean distance of the organ's nodes, inside and out, from where the tracker has them (m). */
static double measure_error(work *w)
{
    int nodes = w->real.mesh.node_count;
    double sum = 0;
    if (reg_track_displacements(w->track, w->displacements) != SB_OK)
        return 0;
    sb_mapping_apply(&w->rows.mapping, w->displacements, w->guess);
    for (int i = 0; i < nodes; i++)
        sum += (double)sb_v3_norm(sb_v3_sub(sb_v3_add(w->real.mesh.nodes[i], w->guess[i]), w->now[i]));
    return sum / nodes;
}

static int is_dropped(const settings *s, double time)
{
    return s->drop > 0 && time > 0.5 * s->drop_every && fmod(time + 0.5 * s->drop_every, s->drop_every) < s->drop;
}

static int track(work *w)
{
    const settings *s = w->set;
    unsigned long long seed = (unsigned long long)s->seed, other = seed + 1000003;
    for (int f = 0; f < w->frames; f++) {
        moment *m = w->moments + f;
        reg_points target;
        reg_track_info info;
        sb_error error;
        memset(&target, 0, sizeof target);
        memset(&info, 0, sizeof info);
        m->time = f / s->rate;
        move_organ(w, m->time);
        target.points = w->points;
        target.count = scan(w, m->time, &seed);
        target.has_camera = 1;
        target.camera = sb_v3(0, 0, w->real.high.z + REAL(1));
        see_marks(w, &other);
        if (!is_dropped(s, m->time) && target.count > 0 && reg_track_set_target(w->track, &target, &error) != SB_OK)
            return complain_of(w, "the scan", &error);
        if (!is_dropped(s, m->time) && w->mark_count > 0 &&
            reg_track_set_features(w->track, w->landmarks, w->curves, &error) != SB_OK)
            return complain_of(w, "the landmarks and curves", &error);
        if (reg_track_step(w->track, 1 / s->rate, &info) != SB_OK)
            return complain_of(w, "a frame", &info.error);
        m->error = measure_error(w);
        m->expected = (double)info.expected;
        m->milliseconds = 1e3 * info.seconds;
        m->state = (int)info.state;
    }
    return 0;
}

/* ---- what is written ------------------------------------------------------------------------------------------- */

static int write_table(const work *w)
{
    char path[ORGAN_PATH + 32];
    sb_output out;
    snprintf(path, sizeof path, "%s.csv", w->set->out);
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return organ_complain_file(&w->real, path);
    fprintf(out.file, "time_s,error_mm,expected_mm,frame_ms,state\n");
    for (int f = 0; f < w->frames; f++) {
        const moment *m = w->moments + f;
        fprintf(out.file, "%.4f,%.4f,%.4f,%.3f,%s\n", m->time, 1e3 * m->error, 1e3 * m->expected, m->milliseconds,
                reg_track_state_string((reg_track_state)m->state));
    }
    return sb_output_close(&out, NULL) == SB_OK ? 0 : organ_complain_file(&w->real, path);
}

static int write_chart(const work *w)
{
    char path[ORGAN_PATH + 32];
    size_t n = (size_t)w->frames;
    double *columns = (double *)malloc(4 * n * sizeof *columns);
    plot p;
    plot_panel *errors, *times;
    int written;
    if (!columns)
        return organ_complain_memory(&w->real);
    for (size_t f = 0; f < n; f++) {
        columns[f] = w->moments[f].time;
        columns[n + f] = 1e3 * w->moments[f].error;
        columns[2 * n + f] = 1e3 * w->moments[f].expected;
        columns[3 * n + f] = w->moments[f].milliseconds;
    }
    plot_begin(&p, "A breathing liver, followed scan by scan");
    errors = plot_add_panel(&p, "error inside the organ", "time (s)", "error (mm)");
    plot_add_curve(errors, "true", columns, columns + n, w->frames);
    plot_add_curve(errors, "expected", columns, columns + 2 * n, w->frames)->dashed = 1;
    times = plot_add_panel(&p, "time of a frame", "time (s)", "time (ms)");
    plot_add_curve(times, "one core", columns, columns + 3 * n, w->frames);
    snprintf(path, sizeof path, "%s.svg", w->set->out);
    written = plot_save_svg(&p, path);
    free(columns);
    return written ? 0 : organ_complain_file(&w->real, path);
}

/* The last line. */
static int tell(const work *w)
{
    double sums[4] = {0, 0, 0, 0}, most = 0;
    int counts[2] = {0, 0}, last = w->moments[w->frames - 1].state;
    for (int f = 0; f < w->frames; f++) {
        const moment *m = w->moments + f;
        int blind = m->state == REG_TRACK_PREDICTS || m->state == REG_TRACK_LOST;
        sums[blind] += m->error;
        counts[blind]++;
        sums[2] += blind ? 0 : m->expected;
        sums[3] += blind ? 0 : m->milliseconds;
        most = fmax(most, m->milliseconds);
    }
    for (int k = 0; k < 2; k++)
        sums[k] /= counts[k] ? counts[k] : 1;
    printf("error_mm=%.3f expected_mm=%.3f blind_mm=%.3f frame_ms=%.2f most_ms=%.2f frames=%d nodes=%d state=%s\n",
           1e3 * sums[0], 1e3 * sums[2] / (counts[0] ? counts[0] : 1), 1e3 * sums[1],
           sums[3] / (counts[0] ? counts[0] : 1), most, w->frames, w->model_mesh.node_count,
           reg_track_state_string((reg_track_state)last));
    return last == REG_TRACK_LOST ? STATUS_LOST : 0;
}

/* ---- the program ----------------------------------------------------------------------------------------------- */

static void free_work(work *w)
{
    reg_track_destroy(w->track);
    reg_model_destroy(w->model);
    sb_embedding_rows_free(&w->rows);
    for (int k = 0; k < PHASES; k++)
        free(w->phase[k]);
    sb_embedding_rows_free(&w->held);
    free(w->marks);
    free(w->seen);
    free(w->landmarks);
    free(w->curves);
    free(w->now);
    free(w->guess);
    free(w->displacements);
    free(w->points);
    free(w->normals);
    free(w->moments);
    sb_mesh_free(&w->model_mesh);
    organ_free(&w->real);
}

static int run(const settings *s)
{
    work w;
    int status;
    memset(&w, 0, sizeof w);
    w.set = s;
    status = make_meshes(&w);
    if (!status)
        status = check_course(&w);
    if (!status)
        status = load_marks(&w);
    if (!status)
        status = breathe_in(&w);
    if (!status)
        status = make_arrays(&w);
    if (!status)
        status = make_tracker(&w);
    if (!status)
        status = track(&w);
    if (!status)
        status = write_table(&w);
    if (!status)
        status = write_chart(&w);
    if (!status)
        status = tell(&w);
    free_work(&w);
    return status;
}

static settings default_settings(void)
{
    settings s;
    memset(&s, 0, sizeof s);
    s.out = "track_liver";
    s.scale = 1;
    s.breath = 0.012, s.push = 0.006, s.period = 4;
    s.noise = 0.7e-3, s.rate = 30, s.seconds = 12;
    s.shadow = 0.03, s.drop = 0.4, s.drop_every = 5;
    s.points = 1000, s.cells = 14, s.modes = 48, s.seed = 1;
    return s;
}

enum { OPTION_COUNT = 19 };
static void list_options(settings *s, option options[OPTION_COUNT])
{
    const option all[OPTION_COUNT] = {
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &s->out, 0, 0, "files are NAME.csv and NAME.svg"},
        {"--scale", "X", OPTION_NUMBER, NULL, &s->scale, NULL, 1e-9, 1e9,
         "multiplies the file's lengths; 0.001 for millimetres"},
        {"--breath", "M", OPTION_NUMBER, NULL, &s->breath, NULL, 0, 1, "that the organ goes down as a whole"},
        {"--push", "M", OPTION_NUMBER, NULL, &s->push, NULL, 0, 1,
         "that its top is pushed down beyond that, at most half its height"},
        {"--period", "S", OPTION_NUMBER, NULL, &s->period, NULL, 0.1, 1000, "of a breath"},
        {"--points", "N", OPTION_INTEGER, &s->points, NULL, NULL, 1, 1e6, "that the camera sees"},
        {"--noise", "M", OPTION_NUMBER, NULL, &s->noise, NULL, 0, 1, "standard deviation of their coordinates"},
        {"--shadow", "M", OPTION_NUMBER, NULL, &s->shadow, NULL, 0, 10, "width of what a tool hides; 0: nothing"},
        {"--drop", "S", OPTION_NUMBER, NULL, &s->drop, NULL, 0, 1000, "how long the camera sees nothing; 0: never"},
        {"--every", "S", OPTION_NUMBER, NULL, &s->drop_every, NULL, 0.1, 1e6, "and how often"},
        {"--landmarks", "FILE", OPTION_TEXT, NULL, NULL, &s->landmarks, 0, 0,
         "lines x y z of points of the organ that are seen, too, with the noise"},
        {"--curves", "FILE", OPTION_TEXT, NULL, NULL, &s->curves, 0, 0,
         "lines c x y z: the next corner of line c (0, 1, ...) of the organ, likewise"},
        {"--rate", "HZ", OPTION_NUMBER, NULL, &s->rate, NULL, 1, 1000, "scans a second"},
        {"--seconds", "S", OPTION_NUMBER, NULL, &s->seconds, NULL, 1, 600, "how long to follow"},
        {"--cells", "N", OPTION_INTEGER, &s->cells, NULL, NULL, 10, 40, "along the model of an organ that is made"},
        {"--modes", "N", OPTION_INTEGER, &s->modes, NULL, NULL, 1, 96, "shapes that the model may take"},
        {"--seed", "N", OPTION_INTEGER, &s->seed, NULL, NULL, 0, 1e6, "of points and noise"},
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
        printf("usage: track_liver [ORGAN] [OPTIONS]\n\n"
               "A breathing organ is followed scan by scan. ORGAN: a volume mesh in metres (VTK, VTU, gmsh, Medit or\n"
               "TetGen), of which both the organ and its model are made; without it a liver-like one is made.\n\n");
        options_print(options, OPTION_COUNT);
        printf("\nThe last line: mean error inside the organ and what the tracker expects of it, the error while the\n"
               "camera sees nothing, mean and longest time of a frame. Status 4: the organ was lost at the end.\n");
        return 0;
    }
    return organ_check_name(program_name, "-o", s.out) ? run(&s) : ORGAN_USAGE;
}

int main(int argc, char **argv) { return finish(program_name, program(argc, argv), ORGAN_USAGE); }
