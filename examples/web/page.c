/* page: an organ that a browser page drags, palpates, cuts and needles (page.html, worker.js). Compiled to wasm as a
 * reactor: functions that are exported, and no main. One scene, for one page has one. Lengths in metres, in space,
 * whatever the page's units; calls return 1, or 0 with a sentence from page_message. */
#define SB_IMPLEMENTATION
#define SB_NO_FILES
#define NDL_IMPLEMENTATION
#include "../../needle.h"

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(__wasm__)
#define EXPORT(name) __attribute__((export_name(#name))) name
#else
#define EXPORT(name) name
#endif

enum tool { DRAG = 0, PALPATE = 1, CUT = 2, NEEDLE = 3 };

static const double young = 8000, poisson = 0.45, density = 1060, gravity = 9.81, toughness = 150; /* J/m^2 */
static const double probe_radius = 0.008, probe_speed = 0.03,
                    probe_depth = 0.015;                          /* m, m/s, m beyond where it touched */
static const double blade_above = 0.02, blade_below = 0.045;      /* m of the edge along the view */
static const double hand_speed = 0.35;                            /* m/s: a pointer that jumps is followed no faster */
static const double needle_speed = 0.03;                          /* m/s */
static const double needle_deepest = 0.07, needle_outside = 0.06; /* m */

static struct scene {
    sb_mesh mesh;
    sb_body *body;
    sb_contact *contact;
    sb_cut *cut;
    sb_cut_surface *surface;
    ndl_needle *needle;
    enum tool tool;
    int pressed;
    int spring, node;         /* of a drag; -1: none */
    int probe, stroke;        /* -1: none */
    double pushed;            /* m that the probe has gone on along the view */
    sb_vec3 pressed_at, view; /* where the pointer met the organ, and along which direction */
    sb_vec3 target, at;       /* where the pointer is, and the hand that follows it */
    sb_vec3 force;            /* N that the hand feels */
    float *vertices;          /* [vertex_room][8] position, normal, von Mises stress (Pa), tag */
    uint32_t *triangles;      /* [triangle_room][3] */
    float *line;              /* [64][3] of the needle's shaft */
    sb_real *stress, *sums;   /* [cells], [vertices] */
    int *shares;              /* [vertices] triangles in a sum */
    int vertex_count, triangle_count, line_count, vertex_room, triangle_room, cell_room;
    char message[320];
} scene;

static int fail(const char *what, const sb_error *error)
{
    snprintf(scene.message, sizeof scene.message, "%s%s%s", what, error ? ": " : "", error ? error->message : "");
    return 0;
}
const char *EXPORT(page_message)(void) { return scene.message; }

/* ---- what is drawn ---- */

static int grow(void **array, int count, size_t size)
{
    void *grown = realloc(*array, (size_t)count * size);
    if (!grown)
        return 0;
    *array = grown;
    return 1;
}

static int make_room(int vertices, int triangles, int cells)
{
    if (vertices > scene.vertex_room) {
        int room = vertices + vertices / 2;
        if (!grow((void **)&scene.vertices, room, 8 * sizeof(float)) ||
            !grow((void **)&scene.sums, room, sizeof(sb_real)) || !grow((void **)&scene.shares, room, sizeof(int)))
            return 0;
        scene.vertex_room = room;
    }
    if (triangles > scene.triangle_room) {
        int room = triangles + triangles / 2;
        if (!grow((void **)&scene.triangles, room, 3 * sizeof(uint32_t)))
            return 0;
        scene.triangle_room = room;
    }
    if (cells > scene.cell_room) {
        int room = cells + cells / 2;
        if (!grow((void **)&scene.stress, room, sizeof(sb_real)))
            return 0;
        scene.cell_room = room;
    }
    return 1;
}

/* Each vertex has the mean stress of the cells that its triangles are of. */
static void draw_stress(const sb_cut_drawing *drawn)
{
    memset(scene.sums, 0, (size_t)drawn->vertex_count * sizeof *scene.sums);
    memset(scene.shares, 0, (size_t)drawn->vertex_count * sizeof *scene.shares);
    sb_body_von_mises(scene.body, scene.stress);
    for (int t = 0; t < drawn->triangle_count; t++)
        for (int c = 0; c < 3 && drawn->cells[t] >= 0; c++) {
            scene.sums[drawn->triangles[t][c]] += scene.stress[drawn->cells[t]];
            scene.shares[drawn->triangles[t][c]]++;
        }
}

static int draw(void)
{
    sb_error error;
    sb_cut_drawing drawn;
    if (sb_cut_surface_update(scene.surface, &error) != SB_OK)
        return fail("surface", &error);
    drawn = sb_cut_surface_get(scene.surface);
    if (!make_room(drawn.vertex_count, drawn.triangle_count, sb_body_element_count(scene.body)))
        return fail("no memory for what is drawn", NULL);
    draw_stress(&drawn);
    for (int v = 0; v < drawn.vertex_count; v++) {
        float *to = scene.vertices + 8 * v;
        sb_vec3 x = drawn.positions[v], n = drawn.normals[v];
        to[0] = (float)x.x, to[1] = (float)x.y, to[2] = (float)x.z;
        to[3] = (float)n.x, to[4] = (float)n.y, to[5] = (float)n.z;
        to[6] = scene.shares[v] ? (float)(scene.sums[v] / scene.shares[v]) : 0;
        to[7] = 0;
    }
    for (int t = 0; t < drawn.triangle_count; t++)
        for (int c = 0; c < 3; c++) {
            scene.triangles[3 * t + c] = (uint32_t)drawn.triangles[t][c];
            if (drawn.tags[t] != SB_CUT_SKIN) /* lips have vertices of their own */
                scene.vertices[8 * drawn.triangles[t][c] + 7] = 1;
        }
    scene.vertex_count = drawn.vertex_count;
    scene.triangle_count = drawn.triangle_count;
    return 1;
}

static void draw_needle(void)
{
    const ndl_rod *rod = scene.needle ? ndl_needle_rod(scene.needle) : NULL;
    int count = rod ? ndl_rod_node_count(rod) : 0;
    scene.line_count = count < 64 ? count : 64;
    for (int i = 0; i < scene.line_count; i++) {
        sb_vec3 x = ndl_rod_positions(rod)[(long)i * (count - 1) / (scene.line_count > 1 ? scene.line_count - 1 : 1)];
        scene.line[3 * i] = (float)x.x, scene.line[3 * i + 1] = (float)x.y, scene.line[3 * i + 2] = (float)x.z;
    }
}

/* ---- making and unmaking ---- */

void EXPORT(page_free)(void)
{
    ndl_needle_destroy(scene.needle);
    sb_contact_destroy(scene.contact);
    sb_cut_surface_destroy(scene.surface);
    sb_cut_destroy(scene.cut);
    sb_body_destroy(scene.body);
    sb_mesh_free(&scene.mesh);
    free(scene.vertices);
    free(scene.triangles);
    free(scene.line);
    free(scene.stress);
    free(scene.sums);
    free(scene.shares);
    memset(&scene, 0, sizeof scene);
    scene.spring = scene.probe = scene.stroke = -1;
}

static int make_body(int cells, sb_error *error)
{
    sb_body_def def = sb_default_body_def();
    sb_vec3 low, high;
    if (sb_mesh_organ(SB_TET4, cells, NULL, &scene.mesh, error) != SB_OK)
        return 0;
    def.mesh = &scene.mesh;
    def.material = sb_material_corotated((sb_real)young, (sb_real)poisson, (sb_real)density);
    def.gravity = sb_v3(0, 0, (sb_real)-gravity);
    def.damping_stiffness = (sb_real)0.02;
    def.tolerance = (sb_real)0.01; /* pictures need no more */
    def.slack = 1;
    if (sb_body_create(&def, &scene.body, error) != SB_OK)
        return 0;
    sb_mesh_bounds(&scene.mesh, &low, &high);
    for (int i = 0; i < scene.mesh.node_count; i++) /* lies on its back, held there */
        if (scene.mesh.nodes[i].z < low.z + (sb_real)0.25 * (high.z - low.z) &&
            sb_body_hold(scene.body, &i, 1, SB_XYZ, error) != SB_OK)
            return 0;
    return 1;
}

int EXPORT(page_make)(int cells)
{
    sb_error error;
    sb_contact_def touch = sb_default_contact_def();
    sb_cut_def cut = sb_default_cut_def();
    page_free();
    if (!make_body(cells, &error))
        return fail("organ", &error);
    touch.body = cut.body = scene.body;
    cut.toughness = (sb_real)toughness;
    if (sb_cut_create(&cut, &scene.cut, &error) != SB_OK ||
        sb_cut_surface_create(scene.cut, NULL, &scene.surface, &error) != SB_OK ||
        sb_contact_create(&touch, &scene.contact, &error) != SB_OK)
        return fail("tools", &error);
    if (!grow((void **)&scene.line, 64, 3 * sizeof(float)))
        return fail("no memory", NULL);
    return draw();
}

/* ---- the pointer ---- */

/* Distance along the ray to the triangle, or a negative number (Moeller and Trumbore 1997). */
static sb_real ray_triangle(sb_vec3 origin, sb_vec3 direction, const sb_vec3 x[3])
{
    sb_vec3 a = sb_v3_sub(x[1], x[0]), b = sb_v3_sub(x[2], x[0]), p = sb_v3_cross(direction, b), q;
    sb_vec3 from = sb_v3_sub(origin, x[0]);
    sb_real det = sb_v3_dot(a, p), u, v;
    if (det <= 0) /* seen from behind */
        return -1;
    u = sb_v3_dot(from, p);
    q = sb_v3_cross(from, a);
    v = sb_v3_dot(direction, q);
    return u < 0 || v < 0 || u + v > det ? -1 : sb_v3_dot(b, q) / det;
}

/* Where the ray meets what is drawn: 1 and the point, or 0. */
static int pick(sb_vec3 origin, sb_vec3 direction, sb_vec3 *hit)
{
    sb_cut_drawing drawn = sb_cut_surface_get(scene.surface);
    sb_real nearest = -1;
    for (int t = 0; t < drawn.triangle_count; t++) {
        sb_vec3 x[3];
        sb_real along;
        for (int c = 0; c < 3; c++)
            x[c] = drawn.positions[drawn.triangles[t][c]];
        along = ray_triangle(origin, direction, x);
        if (along >= 0 && (nearest < 0 || along < nearest))
            nearest = along;
    }
    if (nearest < 0)
        return 0;
    *hit = sb_v3_madd(origin, nearest, direction);
    return 1;
}

static int nearest_node(sb_vec3 place)
{
    const sb_vec3 *x = sb_body_positions(scene.body);
    int best = 0;
    for (int i = 1; i < sb_body_node_count(scene.body); i++)
        if (sb_v3_norm(sb_v3_sub(x[i], place)) < sb_v3_norm(sb_v3_sub(x[best], place)))
            best = i;
    return best;
}

/* The blade's edge through a place, along the view. */
static void blade_at(sb_vec3 place, sb_vec3 edge[2])
{
    edge[0] = sb_v3_madd(place, (sb_real)-blade_above, scene.view);
    edge[1] = sb_v3_madd(place, (sb_real)blade_below, scene.view);
}

static sb_pose probe_at(void)
{
    sb_pose pose;
    pose.position = sb_v3_madd(scene.at, (sb_real)(scene.pushed - probe_radius - 0.001), scene.view);
    pose.rotation = sb_quat_identity();
    return pose;
}

static int begin_needle(sb_error *error)
{
    ndl_needle_def def = ndl_default_needle_def();
    ndl_friction friction = {20, 0, (sb_real)0.2, 0, 0};
    if (scene.needle) /* one is in: it goes on */
        return 1;
    def.body = scene.body;
    def.follow = NDL_EMBED;
    def.base = sb_v3_madd(scene.at, (sb_real)-needle_outside, scene.view);
    def.direction = scene.view;
    def.length = (sb_real)(needle_outside - 0.002);
    def.frictions = &friction;
    def.friction_count = 1;
    ndl_rod_section_preset(NDL_NITINOL_083, &def.section);
    return ndl_needle_create(&def, &scene.needle, error) == SB_OK;
}

static int begin_tool(sb_error *error)
{
    sb_vec3 edge[2];
    sb_tool_def probe = sb_default_tool_def();
    sb_real stiffness = (sb_real)(young * 0.02); /* of a patch of 2 cm */
    switch (scene.tool) {
    case DRAG:
        scene.node = nearest_node(scene.at);
        scene.at = scene.target = sb_body_positions(scene.body)[scene.node];
        return sb_body_add_springs(scene.body, &scene.node, 1, &stiffness, 1, &scene.at, &scene.spring, error) == SB_OK;
    case PALPATE:
        probe.radius = (sb_real)probe_radius;
        probe.friction = (sb_real)0.1;
        probe.pose = probe_at();
        return sb_contact_add_tool(scene.contact, &probe, &scene.probe, error) == SB_OK;
    case CUT: blade_at(scene.at, edge); return sb_cut_begin(scene.cut, edge, 2, &scene.stroke, error) == SB_OK;
    default: return begin_needle(error);
    }
}

static void end_tool(void)
{
    if (scene.spring >= 0)
        sb_body_remove_load(scene.body, scene.spring);
    if (scene.probe >= 0)
        sb_contact_remove_tool(scene.contact, scene.probe);
    if (scene.stroke >= 0)
        sb_cut_end(scene.cut, scene.stroke);
    scene.spring = scene.probe = scene.stroke = -1;
    scene.pressed = 0;
}

/* A pointer goes down: origin and direction (unit) of its ray. 0: it meets nothing, or the tool says why not. */
int EXPORT(page_press)(int tool, double ox, double oy, double oz, double dx, double dy, double dz)
{
    sb_error error;
    sb_vec3 origin = sb_v3((sb_real)ox, (sb_real)oy, (sb_real)oz);
    scene.message[0] = 0;
    end_tool();
    scene.view = sb_v3((sb_real)dx, (sb_real)dy, (sb_real)dz);
    if (!scene.body || tool < DRAG || tool > NEEDLE || !pick(origin, scene.view, &scene.pressed_at))
        return 0;
    scene.tool = (enum tool)tool;
    scene.at = scene.target = scene.pressed_at;
    scene.pushed = 0;
    if (!begin_tool(&error))
        return fail("tool", &error);
    scene.pressed = 1;
    return 1;
}

/* It moves, in the plane through where it met the organ that faces the view. */
void EXPORT(page_move)(double ox, double oy, double oz, double dx, double dy, double dz)
{
    sb_vec3 origin = sb_v3((sb_real)ox, (sb_real)oy, (sb_real)oz), along = sb_v3((sb_real)dx, (sb_real)dy, (sb_real)dz);
    sb_real facing = sb_v3_dot(along, scene.view);
    if (scene.pressed && facing > (sb_real)0.2)
        scene.target = sb_v3_madd(origin, sb_v3_dot(sb_v3_sub(scene.pressed_at, origin), scene.view) / facing, along);
}
void EXPORT(page_release)(void) { end_tool(); }

/* ---- steps ---- */

/* The hand goes after the pointer. */
static void follow_pointer(double dt)
{
    sb_vec3 way = sb_v3_sub(scene.target, scene.at);
    sb_real length = sb_v3_norm(way), most = (sb_real)(hand_speed * dt);
    scene.at = sb_v3_madd(scene.at, length > most ? most / length : 1, way);
}

static int move_tool(double dt, sb_error *error)
{
    sb_vec3 edge[2];
    sb_pose pose;
    sb_cut_info info;
    if (scene.spring >= 0)
        return sb_body_move_springs(scene.body, scene.spring, &scene.at) == SB_OK;
    if (scene.probe >= 0) {
        scene.pushed = sb_min(scene.pushed + probe_speed * dt, probe_depth);
        pose = probe_at();
        return sb_contact_move_tool(scene.contact, scene.probe, &pose) == SB_OK;
    }
    if (scene.stroke < 0)
        return 1;
    blade_at(scene.at, edge);
    if (sb_cut_move(scene.cut, scene.stroke, edge, &info, error) != SB_OK)
        return 0;
    scene.force = info.force;
    return 1;
}

static int step_body(double dt, sb_error *error)
{
    ndl_command command;
    sb_step_info info;
    int in = scene.pressed && scene.tool == NEEDLE;
    if (!scene.needle) {
        if (sb_body_step(scene.body, (sb_real)dt, &info) == SB_OK)
            return 1;
        *error = info.error;
        return 0;
    }
    memset(&command, 0, sizeof command);
    if (in && ndl_needle_depth(scene.needle) < (sb_real)needle_deepest)
        command.insertion = (sb_real)needle_speed;
    if (!in)
        command.insertion = (sb_real)(-2 * needle_speed);
    if (ndl_step(scene.body, &scene.needle, 1, (sb_real)dt, &command, NULL, error) != SB_OK)
        return 0;
    if (!in && ndl_needle_depth(scene.needle) <= 0) {
        ndl_needle_destroy(scene.needle);
        scene.needle = NULL;
    }
    return 1;
}

static void read_force(void)
{
    sb_wrench wrench;
    if (scene.spring >= 0)
        sb_body_spring_forces(scene.body, scene.spring, &scene.force);
    else if (scene.probe >= 0 && sb_contact_wrench(scene.contact, scene.probe, &wrench) == SB_OK)
        scene.force = wrench.force;
    else if (scene.needle)
        ndl_needle_base_wrench(scene.needle, &scene.force, NULL);
    else if (scene.stroke < 0)
        scene.force = sb_v3(0, 0, 0);
}

/* A frame. 0: the step or the tool failed and was undone, the message says why, and the next frame goes on. */
int EXPORT(page_step)(double dt)
{
    sb_error error;
    int fine;
    scene.message[0] = 0;
    if (!scene.body)
        return fail("there is no organ yet", NULL);
    memset(&error, 0, sizeof error);
    follow_pointer(dt);
    fine = move_tool(dt, &error) || fail("tool", &error);
    fine &= step_body(dt, &error) || fail("step", &error);
    read_force();
    draw_needle();
    return draw() && fine;
}

/* ---- readings ---- */
float *EXPORT(page_vertices)(void) { return scene.vertices; }
int EXPORT(page_vertex_count)(void) { return scene.vertex_count; }
uint32_t *EXPORT(page_triangles)(void) { return scene.triangles; }
int EXPORT(page_triangle_count)(void) { return scene.triangle_count; }
float *EXPORT(page_line)(void) { return scene.line; }
int EXPORT(page_line_count)(void) { return scene.line_count; }
int EXPORT(page_element_count)(void) { return sb_body_element_count(scene.body); }
double EXPORT(page_force)(void) { return (double)sb_v3_norm(scene.force); }
/* Where the probe is: component 0, 1, 2, and its radius, 0: none. */
double EXPORT(page_probe)(int component)
{
    sb_pose pose;
    if (scene.probe < 0 || sb_contact_reached(scene.contact, scene.probe, &pose, NULL) != SB_OK)
        return 0;
    return component == 0   ? (double)pose.position.x
           : component == 1 ? (double)pose.position.y
           : component == 2 ? (double)pose.position.z
                            : probe_radius;
}
/* Young's modulus (Pa), Poisson's ratio and gravity (m/s^2, downwards). */
int EXPORT(page_set)(double e, double nu, double g)
{
    sb_error error;
    sb_material material = sb_material_corotated((sb_real)e, (sb_real)nu, (sb_real)density);
    if (!scene.body)
        return fail("there is no organ yet", NULL);
    if (sb_body_set_material(scene.body, &material, &error) != SB_OK)
        return fail("material", &error);
    return sb_body_set_gravity(scene.body, sb_v3(0, 0, (sb_real)-g)) == SB_OK;
}
/* 32 bits of the state, for comparisons between machines. */
uint32_t EXPORT(page_hash)(void)
{
    uint64_t hash = sb_body_state_hash(scene.body);
    return (uint32_t)(hash ^ hash >> 32);
}
