/* viewer_scene.h: what viewer.c shows: an organ that is held at one side, a hand that pulls at it or pushes a needle
 * in, and sessions: all that was done, as text, which played again leads to the same bits. Include it after the
 * implementations of softbody.h and needle.h. Lengths are m, in space; what returns a status gives 0 or, with a message
 * printed, 2 or 3. */
#ifndef VIEWER_SCENE_H
#define VIEWER_SCENE_H

#include <stdint.h>

#include "organ_scene.h"

enum { VIEWER_FPS = 60, VIEWER_SLIDERS = 3, VIEWER_EVENT_NUMBERS = 6 };

typedef enum viewer_event_kind {
    VIEWER_PULL = 0,    /* origin and direction of the pointer's ray */
    VIEWER_PIERCE = 1,  /* likewise: a needle goes in there, or the one that is in goes on */
    VIEWER_MOVE = 2,    /* likewise, while it is down */
    VIEWER_RELEASE = 3, /* nothing */
    VIEWER_OUT = 4,     /* 1: the needle is drawn out from now on, 0: it rests */
    VIEWER_GRAVITY = 5, /* 1, 0 */
    VIEWER_SET = 6,     /* number of a slider, its value */
    VIEWER_EVENTS = 7
} viewer_event_kind;

typedef struct viewer_event {
    int frame; /* before the step of which it happens */
    viewer_event_kind kind;
    double numbers[VIEWER_EVENT_NUMBERS];
} viewer_event;

static const struct {
    char name[10];
    int numbers;
} viewer_event_kinds[VIEWER_EVENTS] = {{"pull", 6}, {"pierce", 6},  {"move", 6}, {"release", 0},
                                       {"out", 1},  {"gravity", 1}, {"set", 2}};

/* Values that a hand may change while the organ moves. */
static const struct {
    char name[24];
    double low, high, start;
    int logarithmic;
} viewer_sliders[VIEWER_SLIDERS] = {{"Young's modulus (Pa)", 500, 100000, 8000, 1},
                                    {"Poisson's ratio", 0, 0.495, 0.45, 0},
                                    {"damping (s)", 0, 0.1, 0.02, 0}};

typedef struct viewer_session {
    viewer_event *events;
    int count, capacity;
    int frames;    /* that it lasted */
    uint64_t hash; /* of the displacements at its end */
} viewer_session;

typedef struct viewer_scene {
    organ o;
    char side;    /* of the organ that is held: 'x', 'y', 'z' or capital: at the high end */
    double share; /* of its length there */
    double values[VIEWER_SLIDERS];
    int falls; /* gravity acts */
    int frame;
    ndl_needle *needle;
    int spring, node;                              /* of a hand that pulls; -1: none */
    int in, out;                                   /* which way the needle goes */
    sb_vec3 pressed_at, view, target, hand, force; /* N on the hand */
    int skipped;                                   /* steps that failed, one after the other */
    char message[320];
    int recording;
    viewer_session recorded, played;
} viewer_scene;

static const double viewer_hand_speed = 0.5; /* m/s: a pointer that jumps is followed no faster */
static const double viewer_needle_speed = 0.03;

static inline int viewer_told(viewer_scene *v, const char *what, const sb_error *error)
{
    snprintf(v->message, sizeof v->message, "%s: %s", what, error->message);
    return 0;
}

/* ---- making ---- */

static inline sb_material viewer_material(const viewer_scene *v)
{
    return sb_material_corotated((sb_real)v->values[0], (sb_real)v->values[1], 1060);
}

static inline int viewer_hold(viewer_scene *v)
{
    sb_vec3 low = v->o.low, high = v->o.high, d = sb_v3_sub(high, low);
    int axis = v->side == 'x' || v->side == 'X' ? 0 : v->side == 'y' || v->side == 'Y' ? 1 : 2;
    double length = (double)(axis == 0 ? d.x : axis == 1 ? d.y : d.z);
    sb_error error;
    for (int i = 0; i < v->o.mesh.node_count; i++) {
        sb_vec3 from = sb_v3_sub(v->o.mesh.nodes[i], low);
        double at = (double)(axis == 0 ? from.x : axis == 1 ? from.y : from.z);
        if ((v->side < 'a' ? length - at : at) <= v->share * length &&
            sb_body_hold(v->o.body, &i, 1, SB_XYZ, &error) != SB_OK)
            return organ_complain_of(&v->o, "--hold", &error, ORGAN_FAILED);
    }
    return 0;
}

/* The organ at rest, with what the sliders say: also to begin anew, for then bits are those of any other beginning. */
static inline int viewer_begin(viewer_scene *v)
{
    sb_body_def def = sb_default_body_def();
    int status;
    ndl_needle_destroy(v->needle);
    sb_body_destroy(v->o.body);
    v->needle = NULL;
    v->o.body = NULL;
    v->spring = v->node = -1;
    v->in = v->out = v->frame = v->skipped = 0;
    v->force = sb_v3(0, 0, 0);
    v->message[0] = 0;
    def.material = viewer_material(v);
    def.gravity = sb_v3(0, 0, (sb_real)(v->falls ? -9.81 : 0));
    def.damping_stiffness = (sb_real)v->values[2];
    def.tolerance = (sb_real)1e-3;
    status = organ_make_body(&v->o, &def, NULL);
    return status ? status : viewer_hold(v);
}

static inline void viewer_free(viewer_scene *v)
{
    ndl_needle_destroy(v->needle);
    organ_free(&v->o);
    free(v->recorded.events);
    free(v->played.events);
}

/* ---- the hand ---- */

/* Where the ray meets the skin as it is now: 1 and the point, or 0 (Moeller and Trumbore 1997). */
static inline int viewer_pick(const viewer_scene *v, sb_vec3 origin, sb_vec3 direction, sb_vec3 *hit)
{
    const sb_mesh *surface = &v->o.boundary.surface;
    const int(*split)[3];
    int pieces = picture_split(surface->element_type, &split), nodes = sb_element_node_count(surface->element_type);
    const sb_vec3 *x = sb_body_positions(v->o.body);
    sb_real nearest = SB_REAL_MAX;
    for (int i = 0; i < surface->element_count * pieces; i++) {
        const int *element = surface->elements + (size_t)(i / pieces) * (size_t)nodes, *s = split[i % pieces];
        sb_vec3 p = x[v->o.boundary.nodes[element[s[0]]]];
        sb_vec3 a = sb_v3_sub(x[v->o.boundary.nodes[element[s[1]]]], p);
        sb_vec3 b = sb_v3_sub(x[v->o.boundary.nodes[element[s[2]]]], p);
        sb_vec3 across = sb_v3_cross(direction, b), from = sb_v3_sub(origin, p), turned = sb_v3_cross(from, a);
        sb_real det = sb_v3_dot(a, across), s0 = sb_v3_dot(from, across), s1 = sb_v3_dot(direction, turned);
        if (det > 0 && s0 >= 0 && s1 >= 0 && s0 + s1 <= det)
            nearest = sb_min(nearest, sb_v3_dot(b, turned) / det);
    }
    if (nearest < SB_REAL_MAX)
        *hit = sb_v3_madd(origin, nearest, direction);
    return nearest < SB_REAL_MAX;
}

static inline int viewer_nearest_node(const viewer_scene *v, sb_vec3 place)
{
    const sb_vec3 *x = sb_body_positions(v->o.body);
    int best = v->o.boundary.nodes[0];
    for (int i = 1; i < v->o.boundary.surface.node_count; i++) {
        int node = v->o.boundary.nodes[i];
        if (sb_v3_norm(sb_v3_sub(x[node], place)) < sb_v3_norm(sb_v3_sub(x[best], place)))
            best = node;
    }
    return best;
}

static inline void viewer_let_go(viewer_scene *v)
{
    if (v->spring >= 0)
        sb_body_remove_load(v->o.body, v->spring);
    v->spring = v->node = -1;
    v->in = 0;
    v->force = sb_v3(0, 0, 0);
}

static inline int viewer_pull(viewer_scene *v)
{
    double size = (double)sb_v3_norm(sb_v3_sub(v->o.high, v->o.low));
    sb_real stiffness = (sb_real)(v->values[0] * size / 10); /* of a patch of a tenth of the organ */
    sb_error error;
    v->node = viewer_nearest_node(v, v->pressed_at);
    v->hand = v->target = v->pressed_at = sb_body_positions(v->o.body)[v->node];
    if (sb_body_add_springs(v->o.body, &v->node, 1, &stiffness, 1, &v->hand, &v->spring, &error) == SB_OK)
        return 1;
    v->spring = -1;
    return viewer_told(v, "the hand", &error);
}

static inline int viewer_pierce(viewer_scene *v)
{
    ndl_needle_def def = ndl_default_needle_def();
    ndl_friction friction = {20, 0, (sb_real)0.2, 0, 0}; /* N/m */
    sb_real size = sb_v3_norm(sb_v3_sub(v->o.high, v->o.low));
    sb_error error;
    v->in = 1;
    v->out = 0;
    if (v->needle)
        return 1;
    def.body = v->o.body;
    def.length = size / 2;
    def.base = sb_v3_madd(v->pressed_at, -(def.length + size / 100), v->view);
    def.direction = v->view;
    def.frictions = &friction;
    def.friction_count = 1;
    ndl_rod_section_preset(NDL_NITINOL_083, &def.section);
    if (ndl_needle_create(&def, &v->needle, &error) == SB_OK)
        return 1;
    v->in = 0;
    return viewer_told(v, "the needle", &error);
}

static inline void viewer_change(viewer_scene *v, int slider, double value)
{
    sb_material material;
    sb_error error;
    double before = v->values[slider];
    v->values[slider] = fmin(fmax(value, viewer_sliders[slider].low), viewer_sliders[slider].high);
    material = viewer_material(v);
    if (slider < 2 && sb_body_set_material(v->o.body, &material, &error) != SB_OK) {
        v->values[slider] = before;
        viewer_told(v, "the material", &error);
    }
    if (slider == 2)
        sb_body_set_damping(v->o.body, 0, (sb_real)v->values[2]);
}

/* ---- events ---- */

static inline int viewer_note(viewer_session *s, const viewer_event *event)
{
    if (s->count == s->capacity) {
        int capacity = 2 * s->capacity + 256;
        viewer_event *grown =
            capacity < 1 << 26 ? (viewer_event *)realloc(s->events, (size_t)capacity * sizeof *grown) : NULL;
        if (!grown)
            return 0;
        s->events = grown;
        s->capacity = capacity;
    }
    s->events[s->count++] = *event;
    return 1;
}

/* A press: 1 when it met the organ, else nothing is changed. */
static inline int viewer_press(viewer_scene *v, viewer_event_kind kind, const double *ray)
{
    sb_vec3 origin = sb_v3((sb_real)ray[0], (sb_real)ray[1], (sb_real)ray[2]), hit;
    sb_vec3 along = sb_v3((sb_real)ray[3], (sb_real)ray[4], (sb_real)ray[5]);
    if (!viewer_pick(v, origin, along, &hit))
        return 0;
    viewer_let_go(v);
    v->view = along;
    v->pressed_at = v->target = v->hand = hit;
    return kind == VIEWER_PULL ? viewer_pull(v) : viewer_pierce(v);
}

/* The pointer moves in the plane through where it was pressed that faces the view. */
static inline void viewer_move(viewer_scene *v, const double *ray)
{
    sb_vec3 origin = sb_v3((sb_real)ray[0], (sb_real)ray[1], (sb_real)ray[2]);
    sb_vec3 along = sb_v3((sb_real)ray[3], (sb_real)ray[4], (sb_real)ray[5]);
    sb_real facing = sb_v3_dot(along, v->view);
    if (facing > (sb_real)0.2)
        v->target = sb_v3_madd(origin, sb_v3_dot(sb_v3_sub(v->pressed_at, origin), v->view) / facing, along);
}

/* Does what an event says, and notes it when a session is recorded. 0: a press that met nothing, or was refused. */
static inline int viewer_do(viewer_scene *v, viewer_event_kind kind, const double *numbers)
{
    viewer_event event;
    memset(&event, 0, sizeof event);
    event.frame = v->frame;
    event.kind = kind;
    if (viewer_event_kinds[kind].numbers)
        memcpy(event.numbers, numbers, (size_t)viewer_event_kinds[kind].numbers * sizeof *numbers);
    if (v->recording && !viewer_note(&v->recorded, &event)) {
        v->recording = 0;
        snprintf(v->message, sizeof v->message, "no memory to record");
    }
    switch (kind) {
    case VIEWER_PULL:
    case VIEWER_PIERCE: return viewer_press(v, kind, numbers);
    case VIEWER_MOVE: viewer_move(v, numbers); break;
    case VIEWER_RELEASE: viewer_let_go(v); break;
    case VIEWER_OUT: v->out = numbers[0] != 0; break;
    case VIEWER_GRAVITY:
        v->falls = numbers[0] != 0;
        sb_body_set_gravity(v->o.body, sb_v3(0, 0, (sb_real)(v->falls ? -9.81 : 0)));
        break;
    default: viewer_change(v, (int)numbers[0], numbers[1]); break;
    }
    return 1;
}

/* ---- steps ---- */

static inline void viewer_follow_pointer(viewer_scene *v)
{
    sb_vec3 way = sb_v3_sub(v->target, v->hand);
    sb_real length = sb_v3_norm(way), most = (sb_real)(viewer_hand_speed / VIEWER_FPS);
    v->hand = sb_v3_madd(v->hand, length > most ? most / length : 1, way);
    if (v->spring >= 0)
        sb_body_move_springs(v->o.body, v->spring, &v->hand);
}

static inline sb_result viewer_advance(viewer_scene *v, sb_error *error)
{
    const sb_real dt = (sb_real)1 / VIEWER_FPS;
    ndl_command command;
    sb_step_info info;
    sb_result result;
    if (!v->needle) {
        result = sb_body_step(v->o.body, dt, &info);
        *error = info.error;
        return result;
    }
    memset(&command, 0, sizeof command);
    command.insertion = (sb_real)(v->in ? viewer_needle_speed : v->out ? -2 * viewer_needle_speed : 0);
    result = ndl_step(v->o.body, &v->needle, 1, dt, &command, NULL, error);
    if (!result && v->out && ndl_needle_depth(v->needle) <= 0) {
        ndl_needle_destroy(v->needle);
        v->needle = NULL;
        v->out = 0;
    }
    return result;
}

/* A frame. A step that fails is undone: the hand lets go, the message says why, and the next frame goes on. */
static inline void viewer_step(viewer_scene *v)
{
    sb_error error;
    viewer_follow_pointer(v);
    v->frame++;
    if (viewer_advance(v, &error) != SB_OK) {
        v->skipped++;
        viewer_told(v, "a step was undone", &error);
        viewer_let_go(v);
        return;
    }
    v->skipped = 0;
    if (v->spring >= 0)
        sb_body_spring_forces(v->o.body, v->spring, &v->force);
    else if (v->needle)
        ndl_needle_base_wrench(v->needle, &v->force, NULL);
    else
        v->force = sb_v3(0, 0, 0);
}

/* Of the displacements' bits (FNV-1a). */
static inline uint64_t viewer_hash(const viewer_scene *v)
{
    const unsigned char *bytes = (const unsigned char *)sb_body_displacements(v->o.body);
    size_t size = (size_t)v->o.mesh.node_count * sizeof(sb_vec3);
    uint64_t hash = 14695981039346656037u;
    for (size_t i = 0; i < size; i++)
        hash = (hash ^ bytes[i]) * 1099511628211u;
    return hash;
}

/* ---- sessions as files ---- */

/* Ends a recording and writes it: what the scene was, a line for each event, and what it came to. */
static inline int viewer_save(viewer_scene *v, const char *path, const double *start, int fell)
{
    sb_output out;
    v->recording = 0;
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return organ_complain_file(&v->o, path);
    fprintf(out.file, "viewer 1\norgan %d %d\nstart %d", v->o.mesh.node_count, v->o.mesh.element_count, fell);
    for (int i = 0; i < VIEWER_SLIDERS; i++)
        fprintf(out.file, " %.17g", start[i]);
    fputc('\n', out.file);
    for (int i = 0; i < v->recorded.count; i++) {
        const viewer_event *event = &v->recorded.events[i];
        fprintf(out.file, "%d %s", event->frame, viewer_event_kinds[event->kind].name);
        for (int k = 0; k < viewer_event_kinds[event->kind].numbers; k++)
            fprintf(out.file, " %.17g", event->numbers[k]);
        fputc('\n', out.file);
    }
    fprintf(out.file, "%d end %llu\n", v->frame, (unsigned long long)viewer_hash(v));
    return sb_output_close(&out, NULL) == SB_OK ? 0 : organ_complain_file(&v->o, path);
}

static inline int viewer_complain_line(const viewer_scene *v, const char *path, int line, const char *what)
{
    char place[ORGAN_PATH + 64];
    snprintf(place, sizeof place, "%s:%d", path, line);
    return organ_complain(&v->o, place, what, ORGAN_USAGE);
}

/* Finite numbers at the end of a line: exactly `count` of them. */
static inline int viewer_read_numbers(const char *text, int count, double *numbers)
{
    for (int i = 0; i < count; i++) {
        char *end;
        numbers[i] = strtod(text, &end);
        if (end == text || numbers[i] - numbers[i] != 0)
            return 0;
        text = end;
    }
    return text[strspn(text, " \t\r\n")] == 0;
}

static inline int viewer_read_event(viewer_scene *v, const char *path, int line, const char *text)
{
    viewer_event event;
    char name[16];
    int used = 0, last = v->played.count ? v->played.events[v->played.count - 1].frame : 0;
    memset(&event, 0, sizeof event);
    if (sscanf(text, "%9d %15s%n", &event.frame, name, &used) != 2 || event.frame < last)
        return viewer_complain_line(v, path, line, "not a frame, after the one before, and what happens in it");
    if (strcmp(name, "end") == 0) {
        unsigned long long hash;
        if (sscanf(text + used, "%llu", &hash) != 1)
            return viewer_complain_line(v, path, line, "end needs the hash of the displacements");
        v->played.frames = event.frame;
        v->played.hash = hash;
        return 0;
    }
    for (int kind = 0; kind < VIEWER_EVENTS; kind++)
        if (strcmp(name, viewer_event_kinds[kind].name) == 0) {
            event.kind = (viewer_event_kind)kind;
            if (!viewer_read_numbers(text + used, viewer_event_kinds[kind].numbers, event.numbers) ||
                (kind == VIEWER_SET && !(event.numbers[0] >= 0 && event.numbers[0] < VIEWER_SLIDERS)))
                return viewer_complain_line(v, path, line, "numbers that the event does not have");
            return viewer_note(&v->played, &event) ? 0 : organ_complain_memory(&v->o);
        }
    return viewer_complain_line(v, path, line, "an event that is not known");
}

static inline int viewer_read_start(viewer_scene *v, const char *path, int line, const char *text)
{
    double n[VIEWER_SLIDERS + 1];
    if (line == 1)
        return strncmp(text, "viewer 1", 8) == 0 ? 0 : viewer_complain_line(v, path, line, "is no session of viewer");
    if (line == 2) {
        if (strncmp(text, "organ ", 6) != 0 || !viewer_read_numbers(text + 6, 2, n))
            return viewer_complain_line(v, path, line, "not: organ NODES ELEMENTS");
        if (n[0] != v->o.mesh.node_count || n[1] != v->o.mesh.element_count)
            return viewer_complain_line(v, path, line, "a session with another organ");
        return 0;
    }
    if (strncmp(text, "start ", 6) != 0 || !viewer_read_numbers(text + 6, VIEWER_SLIDERS + 1, n))
        return viewer_complain_line(v, path, line, "not: start GRAVITY and a number for each slider");
    for (int i = 0; i < VIEWER_SLIDERS; i++) {
        if (!(n[i + 1] >= viewer_sliders[i].low && n[i + 1] <= viewer_sliders[i].high))
            return viewer_complain_line(v, path, line, "a slider is out of its range");
        v->values[i] = n[i + 1];
    }
    v->falls = n[0] != 0;
    return 0;
}

/* Reads a session and sets the scene to its start. */
static inline int viewer_load(viewer_scene *v, const char *path)
{
    char text[512];
    FILE *file = fopen(path, "r");
    int line = 0, status = 0;
    if (!file)
        return organ_complain(&v->o, path, "cannot be read", ORGAN_USAGE);
    v->played.count = 0;
    v->played.frames = -1;
    while (!status && v->played.frames < 0 && fgets(text, sizeof text, file)) {
        line++;
        status = line <= 3 ? viewer_read_start(v, path, line, text) : viewer_read_event(v, path, line, text);
    }
    fclose(file);
    if (!status && v->played.frames < 0)
        status = viewer_complain_line(v, path, line + 1, "the file ends before the session");
    return status ? status : viewer_begin(v);
}

#endif /* VIEWER_SCENE_H */
