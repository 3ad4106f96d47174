/* igtl_organ.h: an organ that messages of OpenIGTLink move, and the messages that tell how it lies. No sockets. Include
 * it after organ_scene.h and igtl.h.
 *
 *     message    device   what it does
 *     TRANSFORM  Tool     sends the ball that indents the organ to a place; POSITION likewise
 *     POINT      Targets  pulls by springs: the first point of a name takes hold of the organ's nearest node,
 *                         later ones of that name move where it is pulled to, who is not named is let go
 *     STRING     any      a statement of those in igtl_organ_run: "reset" (to rest; all else stays), "young 5000",
 *                         "gravity 0 0 -9.81", "spring 20", "friction 0.3"
 *     COMMAND    any      a statement: its name, and the numbers as text
 *
 * Places further from the organ than a hundred of its diagonals are refused: they are in another unit, or nowhere.
 * A message that is bad changes nothing. Frames are POLYDATA "Organ", the deformed skin with displacement and von Mises
 * stress, TRANSFORM "Tool", where the ball is, NDARRAY "Force", force (N) and torque (N m) on it, and NDARRAY
 * "Positions", those of all nodes. */
#ifndef IGTL_ORGAN_H
#define IGTL_ORGAN_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "igtl.h"
#include "organ_scene.h"

enum { IGTL_TARGETS = 64, IGTL_ROW = 1000 /* of positions, where a side of 65,535 is too short */ };

typedef struct igtl_target {
    char name[65];
    int node; /* of the mesh */
    sb_vec3 point;
} igtl_target;

typedef struct igtl_organ {
    organ scene;
    igtl_space space;
    igtl_crc crc;
    double young, poisson, density, spring; /* Pa, 1, kg/m^3, N/m */
    double radius;                          /* m, of the ball; 0: chosen by the organ's size */
    sb_mesh skin;                           /* triangles between the nodes of scene.boundary */
    int tool;
    igtl_target targets[IGTL_TARGETS];
    int target_count, load;  /* load: of their springs, where there are any */
    sb_vec3 *places, *moves; /* [skin nodes] */
    sb_real *stress;         /* [skin nodes] Pa */
    double *numbers;         /* [3 mesh nodes, padded to rows] */
    unsigned char *message;  /* the last one that was written */
    size_t capacity;
} igtl_organ;

/* ---- making it --------------------------------------------------------------------------------------------------- */

static inline void igtl_organ_free(igtl_organ *o)
{
    organ_free(&o->scene);
    sb_mesh_free(&o->skin);
    free(o->places);
    free(o->moves);
    free(o->stress);
    free(o->numbers);
    free(o->message);
    memset(o, 0, sizeof *o);
}

static inline igtl_organ igtl_organ_default(const char *program)
{
    igtl_organ o;
    memset(&o, 0, sizeof o);
    o.scene = organ_named(program);
    o.space.scale = 1000;
    o.young = 8000; /* a liver, somewhat stiff */
    o.poisson = 0.45;
    o.density = 1060;
    o.spring = 50;
    return o;
}

/* Holds the lowest third of the organ, as if it had grown on there. */
static inline int igtl_organ_hold(igtl_organ *o)
{
    organ *s = &o->scene;
    sb_real level = s->low.z + (s->high.z - s->low.z) / 3;
    for (int i = 0; i < s->mesh.node_count; i++)
        if (s->mesh.nodes[i].z <= level && sb_body_fix_nodes(s->body, &i, 1, SB_XYZ) != SB_OK)
            return organ_complain_memory(s);
    return 0;
}

static inline int igtl_organ_make_body(igtl_organ *o)
{
    organ *s = &o->scene;
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    int status;
    def.material = sb_material_corotated((sb_real)o->young, (sb_real)o->poisson, (sb_real)o->density);
    def.single_rotation = s->mesh.element_type == SB_TET10; /* faster */
    def.gravity = sb_v3(0, 0, (sb_real)-9.81);
    def.damping_stiffness = (sb_real)0.02; /* tissue rings for a few tenths of a second, not longer */
    def.tolerance = (sb_real)1e-2;         /* below what an eye sees */
    status = organ_make_body(s, &def, &contact);
    return status ? status : igtl_organ_hold(o);
}

/* The ball waits above the organ. */
static inline int igtl_organ_add_ball(igtl_organ *o)
{
    organ *s = &o->scene;
    sb_tool_def def = sb_default_tool_def();
    double diagonal = (double)sb_v3_norm(sb_v3_sub(s->high, s->low));
    o->radius = o->radius > 0 ? o->radius : diagonal / 16;
    def.radius = (sb_real)o->radius;
    def.friction = (sb_real)0.3;
    def.pose.position = sb_v3_scale((sb_real)0.5, sb_v3_add(s->low, s->high));
    def.pose.position.z = s->high.z + 2 * def.radius;
    return organ_add_tool(s, &def, &o->tool);
}

static inline size_t igtl_positions_count(const igtl_organ *o)
{
    size_t nodes = (size_t)o->scene.mesh.node_count;
    return nodes > 65535 ? (nodes + IGTL_ROW - 1) / IGTL_ROW * IGTL_ROW : nodes;
}

static inline int igtl_organ_make_buffers(igtl_organ *o)
{
    size_t skin = (size_t)o->scene.boundary.surface.node_count;
    o->places = (sb_vec3 *)malloc(skin * sizeof *o->places);
    o->moves = (sb_vec3 *)malloc(skin * sizeof *o->moves);
    o->stress = (sb_real *)malloc(skin * sizeof *o->stress);
    o->numbers = (double *)calloc(3 * igtl_positions_count(o), sizeof *o->numbers);
    return o->places && o->moves && o->stress && o->numbers ? 0 : organ_complain_memory(&o->scene);
}

/* Makes the body of the mesh that scene.mesh is; returns 0 or an exit status, see organ_scene.h. */
static inline int igtl_organ_make(igtl_organ *o)
{
    sb_error error;
    int status = organ_make_skin(&o->scene);
    if (!status && sb_surface_triangulate(&o->scene.boundary.surface, NULL, &o->skin, &error) != SB_OK)
        status = organ_complain_of(&o->scene, "the organ's skin", &error, ORGAN_USAGE);
    igtl_crc_make(&o->crc);
    status = status ? status : igtl_organ_make_body(o);
    status = status ? status : igtl_organ_add_ball(o);
    return status ? status : igtl_organ_make_buffers(o);
}

/* ---- what comes in ----------------------------------------------------------------------------------------------- */

static inline igtl_status igtl_status_of(int code, const char *name, const char *words)
{
    igtl_status s;
    memset(&s, 0, sizeof s);
    s.code = code;
    snprintf(s.name, sizeof s.name, "%s", name);
    snprintf(s.message, sizeof s.message, "%s", words);
    return s;
}

static inline igtl_status igtl_status_good(void) { return igtl_status_of(IGTL_STATUS_OK, "", "OK"); }
static inline igtl_status igtl_status_bad(const char *name, const char *words)
{
    return igtl_status_of(IGTL_STATUS_UNKNOWN, name, words);
}

static inline igtl_status igtl_status_result(sb_result result, const sb_error *error)
{
    return result == SB_OK ? igtl_status_good() : igtl_status_bad(sb_result_string(result), error->message);
}

/* *place: one of the wire in m; 0 when it is too far off. */
static inline int igtl_organ_place(const igtl_organ *o, const double wire[3], sb_vec3 *place)
{
    const organ *s = &o->scene;
    const double low[3] = {(double)s->low.x, (double)s->low.y, (double)s->low.z};
    const double high[3] = {(double)s->high.x, (double)s->high.y, (double)s->high.z};
    double far = 100 * (double)sb_v3_norm(sb_v3_sub(s->high, s->low)), at[3];
    *place = igtl_from_wire(&o->space, sb_v3((sb_real)wire[0], (sb_real)wire[1], (sb_real)wire[2]));
    at[0] = (double)place->x, at[1] = (double)place->y, at[2] = (double)place->z;
    for (int k = 0; k < 3; k++)
        if (!(at[k] > low[k] - far && at[k] < high[k] + far))
            return 0;
    return 1;
}

static inline igtl_status igtl_status_far(const char *name)
{
    return igtl_status_bad(name, "a place is further off than 100 diagonals of the organ: lengths are mm");
}

static inline igtl_status igtl_organ_send_tool(igtl_organ *o, const double place[3])
{
    sb_error error;
    sb_pose pose;
    sb_result result;
    memset(&error, 0, sizeof error);
    pose.rotation = sb_quat_identity(); /* a ball */
    if (!igtl_organ_place(o, place, &pose.position))
        return igtl_status_far("Tool");
    result = sb_contact_move_tool(o->scene.contact, o->tool, &pose);
    snprintf(error.message, sizeof error.message, "the place of the tool is refused");
    return igtl_status_result(result, &error);
}

/* The node of the skin that is nearest now. */
static inline int igtl_organ_nearest(const igtl_organ *o, sb_vec3 point)
{
    const sb_vec3 *x = sb_body_positions(o->scene.body);
    const sb_boundary *skin = &o->scene.boundary;
    double best = 0;
    int nearest = -1;
    for (int i = 0; i < skin->surface.node_count; i++) {
        sb_vec3 away = sb_v3_sub(x[skin->nodes[i]], point);
        double distance = (double)sb_v3_norm(away);
        if (nearest < 0 || distance < best) {
            nearest = skin->nodes[i];
            best = distance;
        }
    }
    return nearest;
}

/* The target of that name, or NULL. */
static inline const igtl_target *igtl_find_target(const igtl_target *targets, int count, const char *name)
{
    for (int i = 0; i < count; i++)
        if (strcmp(targets[i].name, name) == 0)
            return targets + i;
    return NULL;
}

/* Springs to these targets in place of those before. */
static inline sb_result igtl_organ_pull(igtl_organ *o, const igtl_target *targets, int count, sb_error *error)
{
    int nodes[IGTL_TARGETS], load = o->load;
    sb_vec3 points[IGTL_TARGETS];
    sb_real stiffness = (sb_real)o->spring;
    sb_result result = SB_OK;
    for (int i = 0; i < count; i++) {
        nodes[i] = targets[i].node;
        points[i] = targets[i].point;
    }
    if (count > 0)
        result = sb_body_add_springs(o->scene.body, nodes, count, &stiffness, 1, points, &load, error);
    if (result != SB_OK)
        return result;
    if (o->target_count > 0)
        sb_body_remove_load(o->scene.body, o->load);
    memcpy(o->targets, targets, (size_t)count * sizeof *targets);
    o->target_count = count;
    o->load = load;
    return SB_OK;
}

static inline igtl_status igtl_organ_take_targets(igtl_organ *o, const igtl_message *m)
{
    igtl_target targets[IGTL_TARGETS];
    igtl_point point;
    sb_error error;
    size_t count;
    if (igtl_count_points(m, &count, &error) != SB_OK)
        return igtl_status_bad("POINT", error.message);
    if (count > IGTL_TARGETS)
        return igtl_status_bad("POINT", "more targets than 64");
    for (size_t i = 0; i < count; i++) {
        const igtl_target *held;
        if (igtl_get_point(m, i, &point, &error) != SB_OK)
            return igtl_status_bad("POINT", error.message);
        if (igtl_find_target(targets, (int)i, point.name))
            return igtl_status_bad("POINT", "two targets have one name");
        if (!igtl_organ_place(o, point.position, &targets[i].point))
            return igtl_status_far("POINT");
        held = igtl_find_target(o->targets, o->target_count, point.name);
        memcpy(targets[i].name, point.name, sizeof point.name);
        targets[i].node = held ? held->node : igtl_organ_nearest(o, targets[i].point);
    }
    return igtl_status_result(igtl_organ_pull(o, targets, (int)count, &error), &error);
}

static inline igtl_status igtl_do_reset(igtl_organ *o, const double *numbers)
{
    (void)numbers;
    sb_body_reset(o->scene.body);
    return igtl_status_good();
}

static inline igtl_status igtl_do_young(igtl_organ *o, const double *numbers)
{
    sb_material material = sb_material_corotated((sb_real)numbers[0], (sb_real)o->poisson, (sb_real)o->density);
    sb_error error;
    sb_result result = sb_body_set_material(o->scene.body, &material, &error);
    o->young = result == SB_OK ? numbers[0] : o->young;
    return igtl_status_result(result, &error);
}

static inline igtl_status igtl_do_gravity(igtl_organ *o, const double *numbers)
{
    sb_vec3 gravity = sb_v3((sb_real)numbers[0], (sb_real)numbers[1], (sb_real)numbers[2]);
    sb_result result = sb_body_set_gravity(o->scene.body, gravity);
    return result == SB_OK ? igtl_status_good() : igtl_status_bad(sb_result_string(result), "gravity is refused");
}

static inline igtl_status igtl_do_spring(igtl_organ *o, const double *numbers)
{
    sb_real stiffness = (sb_real)numbers[0];
    if (o->target_count > 0 && sb_body_set_spring_stiffness(o->scene.body, o->load, &stiffness, 1) != SB_OK)
        return igtl_status_bad("spring", "the stiffness is refused");
    o->spring = numbers[0];
    return igtl_status_good();
}

static inline igtl_status igtl_do_friction(igtl_organ *o, const double *numbers)
{
    sb_result result = sb_contact_set_friction(o->scene.contact, o->tool, (sb_real)numbers[0]);
    return result == SB_OK ? igtl_status_good() : igtl_status_bad(sb_result_string(result), "friction is refused");
}

typedef struct igtl_statement {
    const char *name;
    int numbers;
    double low, high; /* in that they must be */
    igtl_status (*run)(igtl_organ *o, const double *numbers);
} igtl_statement;

/* Reads the numbers of a statement and nothing behind them; 0 when it is anything else. */
static inline int igtl_read_numbers(const igtl_statement *s, const char *text, double *numbers)
{
    char *end;
    for (int i = 0; i < s->numbers; i++, text = end) {
        numbers[i] = strtod(text, &end);
        if (end == text || !(numbers[i] >= s->low && numbers[i] <= s->high))
            return 0;
    }
    return text[strspn(text, " \t\r\n")] == 0;
}

static inline igtl_status igtl_organ_run(igtl_organ *o, const char *name, const char *rest)
{
    static const igtl_statement statements[] = {{"reset", 0, 0, 0, igtl_do_reset},
                                                {"young", 1, 1, 1e9, igtl_do_young},
                                                {"gravity", 3, -1000, 1000, igtl_do_gravity},
                                                {"spring", 1, 0, 1e9, igtl_do_spring},
                                                {"friction", 1, 0, 10, igtl_do_friction}};
    double numbers[3] = {0, 0, 0};
    char words[96];
    for (size_t i = 0; i < sizeof statements / sizeof *statements; i++) {
        const igtl_statement *s = statements + i;
        if (strcmp(s->name, name) != 0)
            continue;
        if (igtl_read_numbers(s, rest, numbers))
            return s->run(o, numbers);
        if (s->numbers)
            snprintf(words, sizeof words, "%s takes %d from %g to %g", name, s->numbers, s->low, s->high);
        else
            snprintf(words, sizeof words, "%s takes no numbers", name);
        return igtl_status_bad(name, words);
    }
    return igtl_status_of(IGTL_STATUS_NOT_FOUND, "statement", "known: reset, young, gravity, spring, friction");
}

/* The text as a string of the caller; 0 when it is too long. */
static inline int igtl_copy_text(const igtl_text *t, char *text, size_t size)
{
    if (t->length >= size)
        return 0;
    memcpy(text, t->text, t->length);
    text[t->length] = 0;
    return 1;
}

static inline igtl_status igtl_organ_take_string(igtl_organ *o, const igtl_text *t)
{
    char text[256], *rest;
    if (!igtl_copy_text(t, text, sizeof text))
        return igtl_status_bad("STRING", "the statement is too long");
    rest = text + strcspn(text, " \t\r\n");
    if (*rest)
        *rest++ = 0;
    return igtl_organ_run(o, text, rest);
}

static inline igtl_status igtl_organ_take_command(igtl_organ *o, const igtl_command *c)
{
    char text[256];
    return igtl_copy_text(&c->text, text, sizeof text) ? igtl_organ_run(o, c->name, text)
                                                       : igtl_status_bad("COMMAND", "the text is too long");
}

/* Does what a message says; *known is 0 where it is none of those above. */
static inline igtl_status igtl_organ_take(igtl_organ *o, const igtl_message *m, int *known)
{
    igtl_transform transform;
    igtl_position position;
    igtl_command command;
    igtl_text text;
    sb_error error;
    int is_tool = strcmp(m->header.device, "Tool") == 0;
    *known = 1;
    if (igtl_is(m, "TRANSFORM") && is_tool)
        return igtl_get_transform(m, &transform, &error) == SB_OK ? igtl_organ_send_tool(o, transform.translation)
                                                                  : igtl_status_bad("TRANSFORM", error.message);
    if (igtl_is(m, "POSITION") && is_tool)
        return igtl_get_position(m, &position, &error) == SB_OK ? igtl_organ_send_tool(o, position.position)
                                                                : igtl_status_bad("POSITION", error.message);
    if (igtl_is(m, "POINT") && strcmp(m->header.device, "Targets") == 0)
        return igtl_organ_take_targets(o, m);
    if (igtl_is(m, "STRING"))
        return igtl_get_string(m, &text, &error) == SB_OK ? igtl_organ_take_string(o, &text)
                                                          : igtl_status_bad("STRING", error.message);
    if (igtl_is(m, "COMMAND"))
        return igtl_get_command(m, &command, &error) == SB_OK ? igtl_organ_take_command(o, &command)
                                                              : igtl_status_bad("COMMAND", error.message);
    *known = 0;
    return igtl_status_good();
}

/* ---- what goes out ----------------------------------------------------------------------------------------------- */

/* Room for a message in o->message; returns its content, or NULL when memory is short. */
static inline unsigned char *igtl_organ_begin(igtl_organ *o, const igtl_envelope *e, size_t content)
{
    size_t size = igtl_size(e, content);
    if (size > o->capacity) {
        unsigned char *grown = (unsigned char *)realloc(o->message, size);
        if (!grown)
            return NULL;
        o->message = grown;
        o->capacity = size;
    }
    return igtl_content(e, o->message);
}

/* All igtl_organ_write_...: the bytes in o->message, valid until the next; 0 when memory is short. */
static inline size_t igtl_organ_write_skin(igtl_organ *o, uint64_t time)
{
    const sb_boundary *skin = &o->scene.boundary;
    const sb_vec3 *x = sb_body_positions(o->scene.body), *u = sb_body_displacements(o->scene.body);
    igtl_envelope e = igtl_default_envelope("Organ");
    igtl_attribute fields[2] = {{IGTL_VECTORS, 3, "displacement", 0, &o->moves[0].x},
                                {IGTL_SCALARS, 1, "von_mises", 0, o->stress}};
    igtl_surface surface;
    unsigned char *content;
    size_t size;
    e.time = time;
    sb_body_nodal_von_mises(o->scene.body, o->scene.numbers);
    for (int i = 0; i < skin->surface.node_count; i++) {
        o->places[i] = x[skin->nodes[i]];
        o->moves[i] = u[skin->nodes[i]];
        o->stress[i] = o->scene.numbers[skin->nodes[i]];
    }
    surface.points = o->places;
    surface.point_count = fields[0].count = fields[1].count = (size_t)skin->surface.node_count;
    surface.triangles = o->skin.elements;
    surface.triangle_count = (size_t)o->skin.element_count;
    surface.attributes = fields;
    surface.attribute_count = 2;
    size = igtl_put_surface(NULL, &surface, &o->space);
    content = igtl_organ_begin(o, &e, size);
    if (!content)
        return 0;
    igtl_put_surface(content, &surface, &o->space);
    return igtl_close(&o->crc, "POLYDATA", &e, size, o->message);
}

/* Where the ball is. */
static inline size_t igtl_organ_write_tool(igtl_organ *o, uint64_t time)
{
    igtl_envelope e = igtl_default_envelope("Tool");
    igtl_transform t;
    unsigned char *content = igtl_organ_begin(o, &e, igtl_put_transform(NULL, &t));
    sb_pose pose;
    sb_vec3 place;
    e.time = time;
    if (!content || sb_contact_reached(o->scene.contact, o->tool, &pose, NULL) != SB_OK)
        return 0;
    memset(&t, 0, sizeof t);
    place = igtl_to_wire(&o->space, pose.position);
    for (int i = 0; i < 3; i++)
        t.rotation[i][i] = 1;
    t.translation[0] = (double)place.x, t.translation[1] = (double)place.y, t.translation[2] = (double)place.z;
    return igtl_close(&o->crc, "TRANSFORM", &e, igtl_put_transform(content, &t), o->message);
}

static inline size_t igtl_organ_write_array(igtl_organ *o, const char *device, const igtl_array *a,
                                            const double *values, uint64_t time)
{
    igtl_envelope e = igtl_default_envelope(device);
    unsigned char *content = igtl_organ_begin(o, &e, igtl_put_array(NULL, a, values));
    e.time = time;
    return content ? igtl_close(&o->crc, "NDARRAY", &e, igtl_put_array(content, a, values), o->message) : 0;
}

/* What the organ does to the ball, in the wire's axes: [2][3]. */
static inline size_t igtl_organ_write_force(igtl_organ *o, uint64_t time)
{
    const igtl_space turn = {1, o->space.flip};
    igtl_array a;
    sb_wrench w;
    sb_vec3 force, torque;
    double values[6];
    memset(&a, 0, sizeof a);
    memset(&w, 0, sizeof w);
    sb_contact_wrench(o->scene.contact, o->tool, &w); /* 0 before the first step */
    force = igtl_to_wire(&turn, w.force);
    torque = igtl_to_wire(&turn, w.torque);
    values[0] = (double)force.x, values[1] = (double)force.y, values[2] = (double)force.z;
    values[3] = (double)torque.x, values[4] = (double)torque.y, values[5] = (double)torque.z;
    a.type = IGTL_FLOAT64;
    a.dimensions = 2;
    a.sizes[0] = 2, a.sizes[1] = 3;
    return igtl_organ_write_array(o, "Force", &a, values, time);
}

/* Positions of all nodes of the mesh, float32 [nodes][3]; of more than 65,535 [rows][1000][3], the last row filled up
 * with zeros. */
static inline size_t igtl_organ_write_positions(igtl_organ *o, uint64_t time)
{
    const sb_vec3 *x = sb_body_positions(o->scene.body);
    size_t count = igtl_positions_count(o);
    igtl_array a;
    memset(&a, 0, sizeof a);
    for (int i = 0; i < o->scene.mesh.node_count; i++) {
        sb_vec3 place = igtl_to_wire(&o->space, x[i]);
        double *to = o->numbers + 3 * (size_t)i;
        to[0] = (double)place.x, to[1] = (double)place.y, to[2] = (double)place.z;
    }
    a.type = IGTL_FLOAT32;
    a.dimensions = count > 65535 ? 3 : 2;
    a.sizes[0] = (unsigned)(count > 65535 ? count / IGTL_ROW : count);
    a.sizes[1] = count > 65535 ? IGTL_ROW : 3;
    a.sizes[2] = 3;
    return igtl_organ_write_array(o, "Positions", &a, o->numbers, time);
}

#endif /* IGTL_ORGAN_H */
