/* test_contact_inside: small tools that are made, or put, wholly inside an organ, where they may touch no face: they
 * are refused by name. Outside, in a hollow and in a notch they are not. Judged by the winding number of the organ's
 * surface on organs that nobody chose, bent and turned, of any element and unit of length. CHECK_SLOW=n: n organs;
 * ORGAN=k: organ k alone. */
#include "random_case.h"
#include "skin_scene.h"

enum { INSIDE_KINDS = 4, INSIDE_POINTS = 20 };

typedef struct organ {
    press p;
    sb_surface *surface; /* of the mesh where the body is */
    sb_mesh ball;        /* what tools of meshes are made of */
    sb_vec3 low, high;   /* m: box around it */
    sb_real longest;     /* m: edge between corners, at rest or not */
    double unit;         /* m that stand for 1 m */
    unsigned long long seed;
} organ;

/* ---- organs ---- */

/* Bent and sheared by so much. */
static sb_vec3 bent(const organ *o, sb_vec3 at, double how)
{
    sb_real s = REAL(how), u = REAL(o->unit);
    return sb_v3(at.x + s * at.y * at.z / u, at.y + s * at.x * at.x / u, at.z - s * at.x);
}

static void measure_edges(organ *o, const sb_vec3 *x)
{
    int width = sb_mesh_element_width(&o->p.mesh), corners = sb_element_corner_count(o->p.mesh.element_type);
    for (int e = 0; e < o->p.mesh.element_count; e++)
        for (int i = 0; i < corners * corners; i++) {
            const int *n = o->p.mesh.elements + (size_t)e * (size_t)width;
            o->longest = sb_max(o->longest, sb_v3_norm(sb_v3_sub(x[n[i / corners]], x[n[i % corners]])));
        }
}

/* The surface where the body is. */
static sb_surface *surface_now(const organ *o)
{
    sb_mesh moved;
    sb_boundary boundary;
    sb_surface *surface = NULL;
    CHECK_OK(sb_mesh_copy(&o->p.mesh, NULL, &moved, NULL));
    memcpy(moved.nodes, sb_body_positions(o->p.body), (size_t)moved.node_count * sizeof *moved.nodes);
    CHECK_OK(sb_mesh_boundary(&moved, 1, NULL, &boundary, NULL));
    CHECK_OK(sb_surface_create(&boundary.surface, NULL, &surface, NULL));
    sb_boundary_free(&boundary);
    sb_mesh_free(&moved);
    return surface;
}

/* Of the mesh, which becomes the organ's, bent. */
static void organ_take(organ *o, sb_mesh mesh, double how)
{
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof *u);
    def.material = sb_material_corotated(REAL(5e3), REAL(0.3), REAL(1000 / (o->unit * o->unit)));
    contact.max_contacts = 1 << 14;
    o->p = press_make(mesh, def, contact);
    for (int i = 0; i < mesh.node_count; i++)
        u[i] = sb_v3_sub(bent(o, mesh.nodes[i], how), mesh.nodes[i]);
    CHECK_OK(sb_body_set_displacements(o->p.body, u));
    free(u);
    measure_edges(o, o->p.mesh.nodes);
    measure_edges(o, sb_body_positions(o->p.body));
    o->surface = surface_now(o);
    sb_surface_bounds(o->surface, &o->low, &o->high);
    o->ball = skin_sphere(sb_v3(0, 0, 0), (double)(o->longest / REAL(1.8)), 2);
}

static void organ_make(organ *o, unsigned long long number)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
    sb_mesh mesh;
    sb_quat turn;
    memset(o, 0, sizeof *o);
    o->seed = 0x9E3779B97F4A7C15ULL * (number + 1234);
    for (int i = 0; i < 8; i++)
        check_random(&o->seed);
    random_shape(&o->seed, types[random_below(&o->seed, 6)], &mesh);
    o->unit = random_scale(&o->seed, 1e-3, 1e3);
    turn = random_turn(&o->seed);
    for (int i = 0; i < mesh.node_count; i++)
        mesh.nodes[i] = sb_v3_scale(REAL(o->unit), sb_quat_rotate(turn, mesh.nodes[i]));
    organ_take(o, mesh, check_random_in(&o->seed, 0, 0.3));
}

static void organ_free(organ *o)
{
    sb_surface_destroy(o->surface);
    sb_mesh_free(&o->ball);
    press_free(&o->p);
}

/* ---- tools ---- */

/* About as small as tools may be; *reach (m): no point of it is farther from its position. */
static sb_tool_def small_tool(organ *o, int kind, sb_vec3 chain[2], sb_vec3 at, sb_real *reach)
{
    sb_real radius = o->longest / 7; /* 8 is too thin */
    sb_tool_def def = press_sphere((double)radius, check_random_in(&o->seed, 0, 0.8), at);
    def.pose.rotation = random_turn(&o->seed);
    *reach = kind == 3 ? o->longest / REAL(1.8) : kind == 0 ? radius : 2 * radius;
    if (kind == 1) {
        chain[0] = sb_v3(-radius, 0, 0), chain[1] = sb_v3(radius, 0, 0);
        def.shape = SB_TOOL_CAPSULES;
        def.points = chain;
        def.point_count = 2;
    } else if (kind == 2) {
        def.shape = SB_TOOL_BOX;
        def.half = sb_v3(REAL(1.4) * radius, radius, radius);
        def.radius = radius;
    } else if (kind == 3) {
        def.shape = SB_TOOL_MESH;
        def.surface = &o->ball;
        def.cells = 16;
    }
    return def;
}

/* What it comes to where it is made and where it is put. -1: too thin for this organ, else 1: it was taken. */
static int try_tool(organ *o, const sb_tool_def *def, int says_inside)
{
    sb_contact *contact = o->p.contact;
    sb_tool_def far = *def;
    sb_error error, placed;
    uint64_t hash;
    int tool = -1, moved = -1;
    sb_result result = sb_contact_add_tool(contact, def, &tool, &error), second;
    if (result == SB_ERROR_UNSUPPORTED)
        return -1;
    far.pose.position = sb_v3_add(o->high, sb_v3_scale(5, sb_v3_sub(o->high, o->low)));
    if (result == SB_OK)
        CHECK_OK(sb_contact_remove_tool(contact, tool));
    else
        CHECK(tool == -1);
    CHECK_OK(sb_contact_add_tool(contact, &far, &moved, NULL));
    hash = sb_body_state_hash(o->p.body);
    second = sb_contact_place_tool(contact, moved, &def->pose, &placed);
    CHECK_RESULT(second, result);
    if (result != SB_OK) {
        CHECK_RESULT(result, SB_ERROR_ARGUMENT);
        CHECK(error.element >= 0 && error.element < o->p.mesh.element_count && placed.element == error.element);
        CHECK((strstr(error.message, "inside the body") != NULL) == says_inside || !says_inside);
        CHECK(strcmp(error.message, placed.message) == 0);
        CHECK(sb_body_state_hash(o->p.body) == hash);
    }
    CHECK_OK(sb_contact_remove_tool(contact, moved));
    return result == SB_OK;
}

/* The middle of an element, or any place near the organ. */
static sb_vec3 some_place(organ *o, int is_middle)
{
    const sb_vec3 *x = sb_body_positions(o->p.body);
    int width = sb_mesh_element_width(&o->p.mesh), element = random_below(&o->seed, o->p.mesh.element_count);
    sb_vec3 wide = sb_v3_sub(o->high, o->low), sum = {0, 0, 0};
    if (!is_middle)
        return sb_v3(o->low.x + REAL(check_random_in(&o->seed, -0.2, 1.2)) * wide.x,
                     o->low.y + REAL(check_random_in(&o->seed, -0.2, 1.2)) * wide.y,
                     o->low.z + REAL(check_random_in(&o->seed, -0.2, 1.2)) * wide.z);
    for (int a = 0; a < width; a++)
        sum = sb_v3_madd(sum, 1 / REAL(width), x[o->p.mesh.elements[element * width + a]]);
    return sum;
}

/* Places in and near the organ: what has its middle inside, or is wholly outside, is known. */
static void organ_places(organ *o, int tried[3])
{
    sb_vec3 chain[2];
    for (int k = 0; k < INSIDE_POINTS; k++) {
        sb_vec3 at = some_place(o, k % 2);
        sb_real reach;
        sb_tool_def def = small_tool(o, k < 2 ? 3 : k / 2 % 3, chain, at, &reach);
        double turns = (double)sb_surface_winding_number_exact(o->surface, at);
        sb_real distance = sb_abs(sb_surface_signed_distance(o->surface, at, NULL));
        int is_clear = distance > REAL(1.05) * reach, taken;
        if (turns > 1.5 || turns < -0.5) /* bent through itself */
            continue;
        taken = try_tool(o, &def, turns > 0.5 && is_clear);
        if (turns > 0.5)
            CHECK(taken != 1);
        else if (is_clear)
            CHECK(taken != 0);
        tried[turns > 0.5 ? is_clear : 2] += taken >= 0;
    }
}

static void test_random(void)
{
    const char *one = getenv("ORGAN"), *slow = getenv("CHECK_SLOW");
    int count = one ? 1 : slow ? atoi(slow) : check_quick() ? 8 : 24, tried[3] = {0, 0, 0};
    for (int i = 0; i < count; i++) {
        unsigned long long number = (unsigned long long)(one ? atoi(one) : i);
        int failures = check.failures;
        organ o;
        organ_make(&o, number);
        organ_places(&o, tried);
        organ_free(&o);
        if (check.failures != failures)
            printf("organ %llu\n", number);
    }
    printf("%d tools with their middle inside, %d wholly inside, %d outside\n", tried[0], tried[1], tried[2]);
    CHECK(one || (tried[0] > count / 2 && tried[1] > count / 4 && tried[2] > 3 * count));
}

/* ---- hollows, notches, gaps ---- */

typedef int (*is_empty)(sb_vec3 middle); /* of a cell, in units of the block */

/* A block of n^3 cells without some. */
static sb_mesh carved(sb_element_type type, int n, double unit, is_empty empty)
{
    sb_mesh mesh = scene_box(type, n, n, n, sb_v3(REAL(unit), REAL(unit), REAL(unit)), 0);
    int width = sb_mesh_element_width(&mesh), corners = sb_element_corner_count(type), kept = 0;
    for (int e = 0; e < mesh.element_count; e++) {
        const int *nodes = mesh.elements + (size_t)e * (size_t)width;
        sb_vec3 middle = {0, 0, 0};
        for (int a = 0; a < corners; a++)
            middle = sb_v3_madd(middle, 1 / REAL(corners * unit), mesh.nodes[nodes[a]]);
        if (!empty(middle))
            memmove(mesh.elements + (size_t)kept++ * (size_t)width, nodes, (size_t)width * sizeof(int));
    }
    mesh.element_count = kept;
    return mesh;
}

static int in_hollow(sb_vec3 m)
{
    return sb_abs(m.x - REAL(0.5)) < REAL(0.3) && sb_abs(m.y - REAL(0.5)) < REAL(0.3) &&
           sb_abs(m.z - REAL(0.5)) < REAL(0.3);
}
static int in_notch(sb_vec3 m)
{
    return sb_abs(m.x - REAL(0.5)) < REAL(0.3) && sb_abs(m.y - REAL(0.5)) < REAL(0.3) && m.z > REAL(0.2);
}
static int in_gap(sb_vec3 m) { return m.y > REAL(0.2) && m.y < REAL(0.8); } /* between two organs */

static void in_empty(sb_element_type type, double unit, is_empty empty)
{
    organ o;
    sb_vec3 chain[2];
    memset(&o, 0, sizeof o);
    o.unit = unit;
    o.seed = 99;
    organ_take(&o, carved(type, 5, unit, empty), 0.2);
    for (int kind = 0; kind < INSIDE_KINDS; kind++) {
        sb_vec3 hole = sb_v3(REAL(0.5 * unit), REAL(0.5 * unit), REAL(0.5 * unit)), wall = hole;
        sb_real reach;
        sb_tool_def def = small_tool(&o, kind, chain, bent(&o, hole, 0.2), &reach);
        CHECK_INT(try_tool(&o, &def, 0), 1);
        wall.y = REAL(0.1 * unit); /* in a wall as thick as a cell */
        def.pose.position = bent(&o, wall, 0.2);
        CHECK_INT(try_tool(&o, &def, 0), 0);
    }
    organ_free(&o);
}

static void test_empty(void)
{
    static const is_empty holes[] = {in_hollow, in_notch, in_gap};
    static const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20};
    for (int i = 0; i < 12; i++)
        in_empty(types[i % 4], i % 3 == 0 ? 1 : i % 3 == 1 ? 1e-3 : 1e3, holes[i / 4]);
}

/* ---- skins ---- */

/* 1: taken. A ball at a place in a block of 60 mm with a skin in it. */
static int skin_takes(const skinned *s, sb_vec3 at, double unit)
{
    sb_tool_def def = press_sphere(0.002 * unit, 0, sb_v3_scale(REAL(unit), at));
    sb_error error;
    int tool = -1;
    sb_result result = sb_contact_add_tool(s->p.contact, &def, &tool, &error);
    if (result == SB_OK)
        return CHECK_OK(sb_contact_remove_tool(s->p.contact, tool));
    CHECK_RESULT(result, SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "inside the body") != NULL);
    CHECK(error.element >= 0 && error.element < s->p.mesh.element_count);
    return 0;
}

/* Triangles of a ball below a height. */
static void open_above(sb_mesh *surface, sb_real height)
{
    int kept = 0;
    for (int t = 0; t < surface->element_count; t++) {
        const int *n = surface->elements + 3 * t;
        sb_real z = sb_max(surface->nodes[n[0]].z, sb_max(surface->nodes[n[1]].z, surface->nodes[n[2]].z));
        if (z < height)
            memmove(surface->elements + 3 * kept++, n, 3 * sizeof *n);
    }
    surface->element_count = kept;
}

static void skin_of(sb_element_type type, double unit, int is_open)
{
    sb_real side = REAL(0.06 * unit), half = REAL(0.03 * unit);
    sb_mesh surface = skin_sphere(sb_v3(half, half, half), 0.02 * unit, 4);
    skinned s;
    if (is_open)
        open_above(&surface, REAL(0.045 * unit));
    s = skin_make(scene_box(type, 3, 3, 3, sb_v3(side, side, side), 0.1), surface, skin_tissue(5e3, 0.4),
                  sb_default_contact_def());
    CHECK_INT(skin_takes(&s, sb_v3(REAL(0.03), REAL(0.03), REAL(0.03)), unit), is_open); /* below the hole */
    CHECK_INT(skin_takes(&s, sb_v3(REAL(0.013), REAL(0.03), REAL(0.03)), unit), 0);      /* below the rim */
    CHECK_INT(skin_takes(&s, sb_v3(REAL(0.006), REAL(0.03), REAL(0.03)), unit), 1);      /* in the mesh, off the skin */
    CHECK_INT(skin_takes(&s, sb_v3(REAL(0.044), REAL(0.044), REAL(0.044)), unit), 1);
    skin_free(&s);
}

static void test_skins(void)
{
    skin_of(SB_TET4, 1, 0);
    skin_of(SB_TET10, 1e-3, 0);
    skin_of(SB_HEX8, 1e3, 0);
    skin_of(SB_TET4, 1, 1);
    skin_of(SB_HEX8, 1e3, 1);
}

/* ---- bodies that are put over tools ---- */

/* The body jumps over a tool, steps, and jumps back. */
static void put_over(sb_integrator integrator, double unit)
{
    sb_body_def def = sb_default_body_def();
    sb_real side = REAL(0.06 * unit);
    sb_tool_def ball = press_sphere(0.003 * unit, 0, sb_v3(REAL(0.131 * unit), side / 2, side / 2)), other = ball;
    sb_vec3 *u;
    press p;
    def.material = sb_material_corotated(REAL(5e3), REAL(0.4), REAL(1000 / (unit * unit)));
    def.integrator = integrator;
    p = press_make(scene_box(SB_TET4, 5, 5, 5, sb_v3(side, side, side), 0.1), def, sb_default_contact_def());
    other.pose.position.y = 10 * side;
    u = (sb_vec3 *)calloc((size_t)p.mesh.node_count, sizeof *u);
    press_add(&p, &ball);
    press_add(&p, &other);
    for (int i = 0; i < 6; i++) {
        int is_over = i == 2 || i == 3;
        for (int k = 0; k < p.mesh.node_count; k++)
            u[k].x = is_over ? REAL(0.1 * unit) : 0;
        CHECK_OK(sb_body_set_displacements(p.body, u));
        CHECK(press_try_step(&p, 1e-3));
        CHECK_INT(sb_contact_get_info(p.contact).inside, is_over);
    }
    free(u);
    press_free(&p);
}

static void test_put_over(void)
{
    put_over(SB_EULER, 1);
    put_over(SB_EULER, 1e-3);
    put_over(SB_GENERALISED_ALPHA, 1e3);
    put_over(SB_CENTRAL_DIFFERENCE, 1);
}

CHECK_SUITE(contact_inside, {"random organs", test_random}, {"hollows, notches, gaps", test_empty},
            {"skins", test_skins}, {"bodies put over tools", test_put_over});
