/* test_contact_pairs: organs that touch each other and themselves: balances, what is thrown, folded and pressed,
 * states.
 */
#include "contact_scene.h"

/* ---- two boxes in one mesh ---- */

typedef struct boxes {
    sb_element_type type;
    int lower, upper; /* cells a side */
    sb_vec3 size[2];  /* m */
    sb_vec3 at;       /* of the upper one, whose first corner it is (m) */
    double shake;     /* of inner nodes */
    double turn;      /* of the upper one about x (rad) */
} boxes;

static sb_mesh boxes_mesh(const boxes *b, int *lower_nodes, int *lower_cells)
{
    sb_mesh mesh = scene_box(b->type, b->lower, b->lower, b->lower, b->size[0], b->shake);
    sb_mesh other = scene_box(b->type, b->upper, b->upper, b->upper, b->size[1], b->shake);
    sb_quat turn = sb_quat_from_rotation_vector(sb_v3(REAL(b->turn), 0, 0));
    for (int i = 0; i < other.node_count; i++)
        other.nodes[i] = sb_v3_add(sb_quat_rotate(turn, other.nodes[i]), b->at);
    *lower_nodes = mesh.node_count;
    *lower_cells = mesh.element_count;
    CHECK_OK(sb_mesh_append(&mesh, &other, NULL));
    sb_mesh_free(&other);
    return mesh;
}

/* A smaller box just above a larger one. */
static boxes boxes_stacked(sb_element_type type, int lower, int upper, double side)
{
    boxes b;
    memset(&b, 0, sizeof b);
    b.type = type;
    b.lower = lower;
    b.upper = upper;
    b.size[0] = sb_v3(REAL(side), REAL(side), REAL(side));
    b.size[1] = sb_v3_scale(REAL(0.8), b.size[0]);
    b.at = sb_v3(REAL(0.11 * side), REAL(0.07 * side), REAL(1.001 * side));
    b.shake = 0.1;
    return b;
}

static sb_contact_def touching(int pairs, double friction)
{
    sb_contact_def def = press_exact();
    def.pairs = pairs;
    def.pair_friction = REAL(friction);
    return def;
}

/* Force that pairs exert on the cells from `first` on: as the list has it. */
static sb_vec3 force_on(const press *p, int first)
{
    sb_vec3 sum = {0, 0, 0};
    int count = sb_contact_points(p->contact, NULL, 0);
    sb_contact_point *points = (sb_contact_point *)calloc((size_t)count + 1, sizeof *points);
    CHECK_INT(sb_contact_points(p->contact, points, count), count);
    for (int i = 0; i < count; i++)
        if (points[i].tool < 0) {
            CHECK((points[i].element >= first) != (points[i].other_element >= first));
            sum = sb_v3_madd(sum, points[i].element >= first ? 1 : -1, points[i].force);
        }
    free(points);
    return sum;
}

/* ---- a cube rests on another ---- */

static void check_weight(sb_element_type type, int lower, int upper, double scale)
{
    const double side = 0.04 * scale, g = 9.81, weight = 1000 * 0.512 * side * side * side * g;
    boxes b = boxes_stacked(type, lower, upper, side);
    sb_body_def def = sb_default_body_def();
    int nodes, cells;
    sb_mesh mesh = boxes_mesh(&b, &nodes, &cells);
    sb_vec3 force, reaction = {0, 0, 0};
    double both = 1000 * side * side * side * 1.512 * g, tolerance = scene_tolerance(1e-8, 1e5);
    press p;
    def.material = sb_material_corotated(REAL(2e4 * scale), REAL(0.4), 1000);
    def.damping_stiffness = REAL(0.02 * sqrt(scale));
    def.gravity = sb_v3(0, 0, REAL(-g));
    def.tolerance = sb_max(REAL(1e-11), 100 * SB_EPSILON);
    p = press_make(mesh, def, touching(SB_CONTACT_ORGANS, 0));
    scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    scene_fix_plane(p.body, &p.mesh, 2, 1.801 * side, SB_X | SB_Y); /* without friction it would slide off */
    for (int i = 0; i < 350; i++)
        if (!CHECK_OK(sb_body_step(p.body, REAL(0.01 * sqrt(scale)), NULL)))
            break;
    force = force_on(&p, cells);
    CHECK_NEAR(force.z, weight, tolerance * weight);
    for (int i = 0; i < nodes; i++)
        reaction = sb_v3_add(reaction, sb_body_reactions(p.body)[i]);
    CHECK_NEAR(sb_v3_norm(sb_v3_sub(sb_v3(force.x, force.y, 0), sb_v3(reaction.x, reaction.y, 0))), 0,
               tolerance * weight);
    CHECK_NEAR(reaction.z, both, tolerance * both);
    CHECK(sb_contact_get_info(p.contact).deepest < REAL(1e-3 * side));
    press_free(&p);
}

static void test_weight(void)
{
    check_weight(SB_TET4, 3, 4, 1);
    check_weight(SB_HEX8, 4, 3, 1e3);
    if (check_quick())
        return;
    check_weight(SB_TET10, 2, 3, 1);
    check_weight(SB_HEX8, 3, 3, 1);
    check_weight(SB_TET4, 4, 3, 1e-3);
}

/* ---- pressed evenly ---- */

static int is_within(sb_vec3 x, double side)
{
    double edge = 1e-6 * side;
    return x.x > REAL(edge) && x.x < REAL(side - edge) && x.y > REAL(edge) && x.y < REAL(side - edge);
}

/* Of the supports of the first `nodes` nodes together (N). */
static sb_vec3 reaction_of(const press *p, int nodes)
{
    sb_vec3 sum = {0, 0, 0};
    for (int i = 0; i < nodes; i++)
        sum = sb_v3_add(sum, sb_body_reactions(p->body)[i]);
    return sum;
}

/* Two blocks of nu = 0 whose meshes do not match, pressed by `share` of their height. */
static void check_patch(sb_element_type type, int lower, int upper, double tolerance)
{
    const double young = 5e3, side = 0.04, share = 0.02, expected = young * share;
    boxes b = boxes_stacked(type, lower, upper, side);
    sb_body_def def = sb_default_body_def();
    sb_vec3 reaction;
    sb_real *pressures;
    double worst = 0;
    int nodes, cells;
    sb_mesh mesh;
    press p;
    b.size[1] = b.size[0];
    b.at = sb_v3(0, 0, REAL(side));
    mesh = boxes_mesh(&b, &nodes, &cells);
    def.material = sb_material_linear(REAL(young), 0, 1000);
    def.tolerance = sb_max(REAL(1e-11), 100 * SB_EPSILON);
    p = press_make(mesh, def, touching(SB_CONTACT_ORGANS, 0));
    scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    for (int i = 0; i < p.mesh.node_count; i++)
        if (p.mesh.nodes[i].z > REAL(1.9999 * side)) {
            sb_vec3 down = sb_v3(0, 0, REAL(-2 * side * share));
            CHECK_OK(sb_body_prescribe(p.body, &i, 1, SB_XYZ, &down, 1));
        }
    for (int i = 0; i < 60; i++)
        CHECK_OK(sb_body_step(p.body, 10, NULL));
    reaction = reaction_of(&p, nodes);
    CHECK_NEAR(reaction.z, expected * side * side, tolerance * expected * side * side);
    for (int i = 0; i < 10; i++) { /* at rest nothing trembles */
        sb_vec3 next;
        CHECK_OK(sb_body_step(p.body, 10, NULL));
        next = reaction_of(&p, nodes);
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(next, reaction)), 0, scene_tolerance(1e-6, 100) * expected * side * side);
        reaction = next;
    }
    pressures = (sb_real *)calloc((size_t)p.mesh.node_count, sizeof *pressures);
    CHECK_OK(sb_contact_pressures(p.contact, pressures));
    for (int i = 0; i < nodes; i++)
        if (sb_element_corner_count(type) == sb_element_node_count(type) && p.mesh.nodes[i].z > REAL(0.9999 * side) &&
            is_within(p.mesh.nodes[i], side)) /* others have other faces, too, which nothing presses */
            worst = fmax(worst, fabs((double)pressures[i] / expected - 1));
    CHECK(worst < 5e-3);
    free(pressures);
    press_free(&p);
}

static void test_patch(void)
{
    check_patch(SB_TET4, 3, 4, 1e-4);
    check_patch(SB_HEX8, 3, 5, 1e-4);
    check_patch(SB_TET10, 2, 3, 1e-4);
    check_patch(SB_HEX8, 3, 3, scene_tolerance(1e-9, 1e5));
}

/* ---- a block on an inclined one ---- */

static void check_incline(double share, int steps, double *speed, double *acceleration, double *expected)
{
    const double mu = 0.5, g = 9.81, angle = atan(share * mu), dt = 0.01;
    boxes b = boxes_stacked(SB_TET4, 3, 2, 0.02);
    sb_body_def def = sb_default_body_def();
    double half = 0, mass;
    int nodes, cells;
    sb_mesh mesh;
    press p;
    b.size[0] = sb_v3(REAL(0.1), REAL(0.03), REAL(0.01));
    b.at = sb_v3(REAL(0.01), REAL(0.005), REAL(0.01));
    mesh = boxes_mesh(&b, &nodes, &cells);
    def.material = sb_material_corotated(REAL(2e4), REAL(0.4), 1000);
    def.damping_stiffness = REAL(0.01);
    def.gravity = sb_v3(REAL(g * sin(angle)), 0, REAL(-g * cos(angle)));
    def.tolerance = sb_max(REAL(1e-11), 100 * SB_EPSILON);
    p = press_make(mesh, def, touching(SB_CONTACT_ORGANS, mu));
    for (int i = 0; i < nodes; i++)
        CHECK_OK(sb_body_fix_nodes(p.body, &i, 1, SB_XYZ));
    mass = 1000 * 0.016 * 0.016 * 0.016;
    for (int i = 0; i < steps; i++) {
        CHECK_OK(sb_body_step(p.body, REAL(dt), NULL));
        if (i == steps / 2 - 1)
            half = (double)sb_body_momentum(p.body).x / mass;
    }
    *speed = (double)sb_body_momentum(p.body).x / mass;
    *acceleration = (*speed - half) / ((steps - steps / 2) * dt);
    *expected = g * (sin(angle) - mu * cos(angle));
    press_free(&p);
}

static void test_incline(void)
{
    double speed, acceleration, expected;
    check_incline(0.98, 200, &speed, &acceleration, &expected);
    CHECK_NEAR(speed, 0, scene_tolerance(1e-6, 1e5));
    check_incline(1.05, 60, &speed, &acceleration, &expected);
    CHECK_NEAR(acceleration, expected, 2e-3 * 4.34); /* of the friction, mu g cos */
}

/* ---- bodies that fly ---- */

static press thrown(const boxes *b, sb_body_def def, sb_contact_def contact, double speed, int *nodes, int *cells)
{
    sb_mesh mesh = boxes_mesh(b, nodes, cells);
    sb_vec3 *velocity = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof *velocity);
    press p;
    for (int i = *nodes; i < mesh.node_count; i++)
        velocity[i] = sb_v3(REAL(0.1 * speed), REAL(0.05 * speed), REAL(-speed));
    p = press_make(mesh, def, contact);
    CHECK_OK(sb_body_set_velocities(p.body, velocity));
    free(velocity);
    return p;
}

/* What two bodies that hit each other have together stays. */
static void check_momentum(sb_element_type type, int lower, int upper, double scale)
{
    boxes b = boxes_stacked(type, lower, upper, 0.04 * scale);
    sb_body_def def = sb_default_body_def();
    sb_vec3 before;
    double worst = 0;
    int nodes, cells, touched = 0;
    press p;
    b.turn = 0.4;
    b.at = sb_v3(REAL(0.0044 * scale), REAL(0.0108 * scale), REAL(0.045 * scale));
    def.material = sb_material_corotated(REAL(1e4 * scale * scale), REAL(0.4), 1000);
    def.damping_stiffness = REAL(0.004);
    def.tolerance = sb_max(REAL(1e-12), 100 * SB_EPSILON);
    p = thrown(&b, def, touching(SB_CONTACT_ORGANS, 0.4), 1 * scale, &nodes, &cells);
    before = sb_body_momentum(p.body);
    for (int i = 0; i < 40; i++) {
        if (!CHECK_OK(sb_body_step(p.body, REAL(0.004), NULL)))
            break;
        touched += sb_contact_get_info(p.contact).touching > 0;
        worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(sb_body_momentum(p.body), before)));
    }
    CHECK(touched > 5);
    CHECK_NEAR(worst, 0, scene_tolerance(1e-10, 1e4) * (double)sb_v3_norm(before));
    press_free(&p);
}

static void test_momentum(void)
{
    check_momentum(SB_TET4, 3, 4, 1);
    check_momentum(SB_TET10, 2, 2, 1);
    check_momentum(SB_HEX8, 4, 3, 1);
    check_momentum(SB_TET4, 2, 3, 1e-3);
    check_momentum(SB_HEX8, 3, 2, 1e3);
}

/* The surface of one of the two, where it is now. */
static sb_surface *surface_of(const boxes *b, int upper, const sb_vec3 *places)
{
    int cells = upper ? b->upper : b->lower;
    sb_mesh mesh = scene_box(b->type, cells, cells, cells, b->size[upper], b->shake);
    sb_boundary boundary;
    sb_surface *surface = NULL;
    memset(&boundary, 0, sizeof boundary);
    memcpy(mesh.nodes, places, (size_t)mesh.node_count * sizeof *places);
    CHECK_OK(sb_mesh_boundary(&mesh, 0, NULL, &boundary, NULL));
    CHECK_OK(sb_surface_create(&boundary.surface, NULL, &surface, NULL));
    sb_boundary_free(&boundary);
    sb_mesh_free(&mesh);
    return surface;
}

/* Depth (m) of the node of either that is deepest in the other. */
static double deepest_node(const boxes *b, const press *p, int nodes)
{
    const sb_vec3 *x = sb_body_positions(p->body);
    double deepest = 0;
    for (int upper = 0; upper < 2; upper++) {
        sb_surface *surface = surface_of(b, upper, upper ? x + nodes : x);
        for (int i = upper ? 0 : nodes; i < (upper ? nodes : p->mesh.node_count); i++)
            deepest = fmax(deepest, -(double)sb_surface_signed_distance(surface, x[i], NULL));
        sb_surface_destroy(surface);
    }
    return deepest;
}

/* Thrown at another at 3 m/s, with 60 steps a second: it comes no deeper than a part of an element, and lies still at
 * last, on top. */
static void check_throw(sb_element_type type, int lower, int upper, double turn)
{
    boxes b = boxes_stacked(type, lower, upper, 0.06);
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    double worst = 0;
    sb_energy energy;
    int nodes, cells, lowest = 1;
    press p;
    b.size[0] = sb_v3(REAL(0.12), REAL(0.12), REAL(0.04));
    b.size[1] = sb_v3(REAL(0.04), REAL(0.04), REAL(0.03));
    b.turn = turn;
    b.at = sb_v3(REAL(0.035), REAL(0.045), REAL(0.08));
    def.material = sb_material_corotated(REAL(1e4), REAL(0.4), 1000);
    def.damping_stiffness = REAL(0.02);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    contact.pairs = SB_CONTACT_ORGANS;
    contact.pair_friction = REAL(0.5);
    p = thrown(&b, def, contact, 3, &nodes, &cells);
    scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    for (int i = 0; i < 240; i++) {
        if (!CHECK_OK(sb_body_step(p.body, REAL(1.0 / 60), NULL)))
            break;
        if (i < 40 || i % 20 == 0)
            worst = fmax(worst, deepest_node(&b, &p, nodes));
    }
    for (int i = nodes; i < p.mesh.node_count; i++)
        lowest &= sb_body_positions(p.body)[i].z > REAL(0.02);
    CHECK_OK(sb_body_energy(p.body, &energy));
    CHECK(lowest);
    CHECK(worst < 0.3 * 0.12 / lower);
    CHECK((double)energy.kinetic < 1e-6 * 0.5 * 0.048 * 9);
    press_free(&p);
}

static void test_thrown(void)
{
    check_throw(SB_TET4, 4, 4, 0.5);
    if (check_quick())
        return;
    check_throw(SB_TET4, 5, 3, 0);
    check_throw(SB_TET10, 3, 2, 0.3);
    check_throw(SB_HEX8, 5, 3, 0.8);
}

/* ---- an organ and itself ---- */

/* 1 when a node of the boundary, moved by `depth` (m) into its organ, is in the organ twice. */
static int is_twice_inside(const sb_mesh *mesh, const sb_vec3 *places, double depth)
{
    sb_mesh moved = *mesh;
    sb_boundary boundary;
    sb_surface *surface = NULL;
    sb_vec3 *normals = (sb_vec3 *)calloc((size_t)mesh->node_count, sizeof *normals), *x;
    int twice = 0;
    memset(&boundary, 0, sizeof boundary);
    x = (sb_vec3 *)malloc((size_t)mesh->node_count * sizeof *x);
    memcpy(x, places, (size_t)mesh->node_count * sizeof *x);
    moved.nodes = x;
    CHECK_OK(sb_mesh_boundary(&moved, 0, NULL, &boundary, NULL));
    CHECK_OK(sb_surface_create(&boundary.surface, NULL, &surface, NULL));
    for (int t = 0; t < sb_surface_triangle_count(surface); t++) {
        int n[3];
        sb_vec3 across;
        sb_surface_triangle(surface, t, n);
        across = sb_v3_cross(sb_v3_sub(x[n[1]], x[n[0]]), sb_v3_sub(x[n[2]], x[n[0]]));
        for (int k = 0; k < 3; k++)
            normals[n[k]] = sb_v3_add(normals[n[k]], across);
    }
    for (int i = 0; i < mesh->node_count; i++) {
        sb_real size = sb_v3_norm(normals[i]);
        if (size > 0)
            twice +=
                sb_surface_winding_number_exact(surface, sb_v3_madd(x[i], REAL(-depth) / size, normals[i])) > REAL(1.5);
    }
    sb_surface_destroy(surface);
    sb_boundary_free(&boundary);
    free(normals);
    free(x);
    return twice;
}

/* A long strip that stands falls over and folds on a floor. */
static void check_fold(sb_element_type type, int along, int across, int pairs, int *twice, int *touched)
{
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    sb_mesh mesh = scene_box(type, across, 2 * across, along, sb_v3(REAL(0.012), REAL(0.03), REAL(0.3)), 0);
    sb_tool_def floor = press_plane(0.3, sb_v3(0, 0, REAL(-0.0005)), 0);
    press p;
    *twice = *touched = 0;
    for (int i = 0; i < mesh.node_count; i++)
        mesh.nodes[i].x += REAL(0.01 * sin(30 * (double)mesh.nodes[i].z));
    def.material = sb_material_corotated(REAL(4e3), REAL(0.4), 1000);
    def.damping_stiffness = REAL(0.02);
    def.damping_mass = REAL(1);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    contact.pairs = pairs;
    contact.pair_friction = REAL(0.2);
    p = press_make(mesh, def, contact);
    press_add(&p, &floor);
    for (int i = 0; i < 150; i++) {
        int count = 0;
        sb_contact_point *points;
        if (!CHECK_OK(sb_body_step(p.body, REAL(1.0 / 60), NULL)))
            break;
        count = sb_contact_points(p.contact, NULL, 0);
        points = (sb_contact_point *)calloc((size_t)count + 1, sizeof *points);
        sb_contact_points(p.contact, points, count);
        for (int k = 0; k < count; k++)
            *touched += points[k].tool < 0;
        free(points);
        if (i % 5 == 0)
            *twice += is_twice_inside(&p.mesh, sb_body_positions(p.body), 0.45 * 0.012);
    }
    press_free(&p);
}

/* What is left are creases narrower than what is looked at, see contact.h. */
static void test_folded(void)
{
    int twice, touched, without;
    check_fold(SB_HEX8, 40, 2, SB_CONTACT_SELF, &twice, &touched);
    if (!CHECK(twice <= (sizeof(sb_real) == sizeof(float) ? touched / 1000 : 0) && touched > 1000))
        printf("  %d of %d lie in the other half\n", twice, touched);
    if (check_quick())
        return;
    check_fold(SB_TET4, 40, 2, 0, &without, &touched);
    CHECK(without > 1000 && touched == 0);
    check_fold(SB_TET4, 40, 2, SB_CONTACT_SELF, &twice, &touched);
    CHECK(twice <= without / 1000 && touched > 1000);
}

/* A beam whose root is held, and of which a handle near the tip is led around by 270 degrees, so that the tip stands on
 * the beam, and then pressed to and fro. */
typedef struct curl {
    press p;
    int handle[64], count;
    double thick, length, turned; /* m; handle's place along the beam */
} curl;

static curl curl_make(int pairs)
{
    curl c;
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    memset(&c, 0, sizeof c);
    c.thick = 0.008, c.length = 0.12, c.turned = 0.0975;
    def.material = sb_material_corotated(REAL(1e4), REAL(0.3), 1000);
    def.damping_stiffness = REAL(0.02);
    def.damping_mass = REAL(5);
    contact.pairs = pairs;
    contact.pair_friction = REAL(0.2);
    c.p =
        press_make(scene_box(SB_HEX8, 32, 2, 2, sb_v3(REAL(c.length), REAL(c.thick), REAL(c.thick)), 0), def, contact);
    scene_fix_plane(c.p.body, &c.p.mesh, 0, 0, SB_XYZ);
    for (int i = 0; i < c.p.mesh.node_count; i++)
        if (fabs((double)c.p.mesh.nodes[i].x - c.turned) < 0.002)
            c.handle[c.count++] = i;
    return c;
}

/* The handle turned by an angle, of an arc, and moved along x and z. */
static void curl_lead(const curl *c, double angle, double x, double z)
{
    for (int k = 0; k < c->count; k++) {
        const int node = c->handle[k];
        sb_vec3 at = c->p.mesh.nodes[node], way;
        double radius = angle > 0 ? c->turned / angle : 0, up = (double)at.z - 0.5 * c->thick;
        double along = (angle > 0 ? radius * sin(angle) : c->turned) + (double)at.x - c->turned;
        way.x = REAL(along - up * sin(angle) + x - (double)at.x);
        way.y = 0;
        way.z = REAL((angle > 0 ? radius * (1 - cos(angle)) : 0) + up * cos(angle) + 0.5 * c->thick + z - (double)at.z);
        CHECK_OK(sb_body_prescribe(c->p.body, &node, 1, SB_XYZ, &way, 1));
    }
}

static void curl_play(int pairs, int steps, int *twice, int *touched)
{
    curl c = curl_make(pairs);
    *twice = *touched = 0;
    for (int i = 1; i <= steps; i++) {
        double turn = fmin(1, i / 150.0), aside = fmin(1, fmax(0, (i - 150) / 100.0));
        double pressed = i < 250 ? 0 : 0.006 * (1 - cos(0.05 * (i - 250)));
        curl_lead(&c, 1.5 * 3.14159265358979 * turn, 0.05 * aside, -pressed);
        if (!CHECK_OK(sb_body_step(c.p.body, REAL(1.0 / 60), NULL)))
            break;
        *touched += sb_contact_get_info(c.p.contact).touching > 0;
        if (i % 10 == 0)
            *twice += is_twice_inside(&c.p.mesh, sb_body_positions(c.p.body), 0.3 * c.thick);
    }
    press_free(&c.p);
}

/* CHECK_SLOW: 10,000 steps. */
static void test_curled(void)
{
    int twice, touched;
    curl_play(0, 300, &twice, &touched);
    CHECK(twice > 0 && touched == 0);
    curl_play(SB_CONTACT_SELF, getenv("CHECK_SLOW") ? 10000 : 400, &twice, &touched);
    CHECK(touched > 100);
    CHECK_INT(twice, 0);
}

static sb_material pile_material(void) { return sb_material_corotated(REAL(1e4), REAL(0.4), 1000); }

/* ---- static solves, and a mesh that changes ---- */

static void test_static(void)
{
    const double young = 5e3, side = 0.04, share = 0.02, expected = young * share * side * side;
    boxes b = boxes_stacked(SB_TET4, 3, 4, side);
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_vec3 reaction = {0, 0, 0};
    int nodes, cells;
    sb_mesh mesh;
    sb_step_info info;
    press p;
    b.size[1] = b.size[0];
    b.at = sb_v3(0, 0, REAL(side));
    mesh = boxes_mesh(&b, &nodes, &cells);
    def.material = sb_material_linear(REAL(young), 0, 1000);
    p = press_make(mesh, def, touching(SB_CONTACT_ORGANS, 0.2));
    scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    for (int i = 0; i < p.mesh.node_count; i++)
        if (p.mesh.nodes[i].z > REAL(1.9999 * side)) {
            sb_vec3 down = sb_v3(0, 0, REAL(-2 * side * share));
            CHECK_OK(sb_body_prescribe(p.body, &i, 1, SB_XYZ, &down, 1));
        }
    options.tolerance = sb_max(REAL(1e-8), 100 * SB_EPSILON);
    if (!CHECK_OK(sb_body_solve_static(p.body, &options, &info)))
        printf("%s\n", info.error.message);
    for (int i = 0; i < nodes; i++)
        reaction = sb_v3_add(reaction, sb_body_reactions(p.body)[i]);
    CHECK_NEAR(reaction.z, expected, 5e-3 * expected);
    CHECK_NEAR(force_on(&p, cells).z, expected, 5e-3 * expected);
    press_free(&p);
}

/* Cells of the upper box go while it lies on the lower. */
static void test_changed(void)
{
    boxes b = boxes_stacked(SB_TET4, 3, 3, 0.04);
    sb_body_def def = sb_default_body_def();
    int nodes, cells;
    sb_mesh mesh = boxes_mesh(&b, &nodes, &cells);
    press p;
    def.material = pile_material();
    def.damping_stiffness = REAL(0.02);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.slack = REAL(0.5);
    p = press_make(mesh, def, touching(SB_CONTACT_ORGANS, 0.5));
    scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    for (int i = 0; i < 60; i++) {
        if (i == 30)
            scene_remove_cells(p.body);
        if (!CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL)))
            break;
    }
    CHECK(sb_contact_get_info(p.contact).touching > 0);
    CHECK(scene_all_finite(sb_body_positions(p.body), sb_body_node_count(p.body)));
    press_free(&p);
}

/* ---- bits and memory ---- */

/* A box tumbles onto another, which a sphere presses from the side. */
typedef struct pile {
    press p;
    int tool, workers;
} pile;

static void pile_make(pile *s, sb_element_type type, int workers, int pairs, sb_material material,
                      const sb_allocator *allocator)
{
    boxes b = boxes_stacked(type, type == SB_TET10 ? 2 : 3, 2, 0.04);
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    sb_tool_def sphere = press_sphere(0.01, 0.3, sb_v3(REAL(-0.0105), REAL(0.02), REAL(0.03)));
    int nodes, cells;
    b.turn = 0.3;
    b.at = sb_v3(REAL(0.0044), REAL(0.0108), REAL(0.0401));
    s->workers = workers;
    def.material = material;
    def.damping_stiffness = REAL(0.01);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.jobs = scene_jobs(&s->workers);
    if (allocator)
        def.allocator = *allocator;
    contact.pairs = pairs;
    contact.pair_friction = REAL(0.4);
    s->p = thrown(&b, def, contact, 0.5, &nodes, &cells);
    scene_fix_plane(s->p.body, &s->p.mesh, 2, 0, SB_XYZ);
    s->tool = press_add(&s->p, &sphere);
}

static sb_result pile_step(pile *s, int i)
{
    press_move(&s->p, s->tool, sb_v3(REAL(-0.0105 + 2e-4 * (i < 15 ? i : 15)), REAL(0.02), REAL(0.03)),
               sb_quat_identity());
    return sb_body_step(s->p.body, REAL(0.01), NULL);
}

static void pile_steps(pile *s, int from, int to)
{
    for (int i = from; i < to; i++)
        CHECK_OK(pile_step(s, i));
}

static void test_threads(void)
{
    const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8};
    const int workers[] = {1, 2, 16, 3, 8}, both = SB_CONTACT_SELF | SB_CONTACT_ORGANS;
    for (int k = 0; k < 3; k++) {
        uint64_t first = 0;
        for (int w = 0; w < (check_quick() ? 3 : 5); w++) {
            pile s;
            pile_make(&s, types[k], workers[w], both, pile_material(), NULL);
            pile_steps(&s, 0, 25);
            CHECK(sb_contact_get_info(s.p.contact).touching > 10);
            if (w == 0)
                first = sb_body_state_hash(s.p.body);
            CHECK(sb_body_state_hash(s.p.body) == first);
            press_free(&s.p);
        }
    }
}

static void test_saved(void)
{
    pile s, other, tools;
    size_t size;
    void *image;
    uint64_t end;
    pile_make(&s, SB_TET4, 1, SB_CONTACT_ORGANS, pile_material(), NULL);
    pile_make(&other, SB_TET4, 2, SB_CONTACT_ORGANS, pile_material(), NULL);
    pile_make(&tools, SB_TET4, 1, 0, pile_material(), NULL);
    pile_steps(&s, 0, 20);
    size = sb_body_state_size(s.p.body);
    image = malloc(size);
    CHECK_OK(sb_body_state_save(s.p.body, image, size));
    pile_steps(&other, 0, 3); /* anything */
    CHECK_OK(sb_body_state_load(other.p.body, image, size, NULL));
    CHECK(sb_body_state_hash(other.p.body) == sb_body_state_hash(s.p.body));
    CHECK_INT(sb_contact_points(other.p.contact, NULL, 0), sb_contact_points(s.p.contact, NULL, 0));
    pile_steps(&s, 20, 35);
    pile_steps(&other, 20, 35);
    end = sb_body_state_hash(s.p.body);
    CHECK(sb_body_state_hash(other.p.body) == end);
    CHECK_OK(sb_body_state_load(s.p.body, image, size, NULL));
    pile_steps(&s, 20, 35);
    CHECK(sb_body_state_hash(s.p.body) == end);
    CHECK_RESULT(sb_body_state_load(tools.p.body, image, size, NULL), SB_ERROR_STATE);
    size = sb_body_state_size(tools.p.body);
    free(image);
    image = malloc(size);
    CHECK_OK(sb_body_state_save(tools.p.body, image, size));
    CHECK_RESULT(sb_body_state_load(s.p.body, image, size, NULL), SB_ERROR_STATE);
    CHECK(sb_body_state_hash(s.p.body) == end);
    free(image);
    press_free(&s.p);
    press_free(&other.p);
    press_free(&tools.p);
}

static void test_recorded(void)
{
    pile s, other;
    sb_recording *recording = NULL;
    sb_recording_report report;
    pile_make(&s, SB_TET4, 1, SB_CONTACT_ORGANS, pile_material(), NULL);
    pile_make(&other, SB_TET4, 3, SB_CONTACT_ORGANS, pile_material(), NULL);
    pile_steps(&s, 0, 10);
    CHECK_OK(sb_recording_start(s.p.body, 1, NULL, &recording, NULL));
    pile_steps(&s, 10, 25);
    sb_recording_stop(recording);
    if (!CHECK_OK(sb_recording_replay(recording, other.p.body, &report)))
        printf("step %d: %s\n", report.step, report.error.message);
    CHECK(sb_body_state_hash(other.p.body) == sb_body_state_hash(s.p.body));
    sb_recording_destroy(recording);
    press_free(&s.p);
    press_free(&other.p);
}

/* A step that fails leaves pairs as they were. */
static void test_undo(void)
{
    pile s;
    sb_vec3 inside_out = {0, 0, 0};
    uint64_t hash;
    pile_make(&s, SB_TET4, 1, SB_CONTACT_ORGANS, sb_material_neo_hookean(REAL(1e4), REAL(0.4), 1000), NULL);
    pile_steps(&s, 0, 20);
    for (int a = 0; a < 4; a++) {
        int node = s.p.mesh.elements[a];
        inside_out.z = -2 * s.p.mesh.nodes[node].z;
        CHECK_OK(sb_body_prescribe(s.p.body, &node, 1, SB_XYZ, &inside_out, 1));
    }
    hash = sb_body_state_hash(s.p.body);
    CHECK(sb_contact_points(s.p.contact, NULL, 0) > 0);
    CHECK(sb_body_step(s.p.body, REAL(0.01), NULL) != SB_OK);
    CHECK(sb_body_state_hash(s.p.body) == hash);
    press_free(&s.p);
}

static void test_no_allocation(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    pile s;
    int calls;
    pile_make(&s, SB_TET4, 1, SB_CONTACT_SELF | SB_CONTACT_ORGANS, pile_material(), &allocator);
    pile_steps(&s, 0, 1);
    calls = memory.calls;
    pile_steps(&s, 1, 60);
    CHECK_INT(memory.calls, calls);
    press_free(&s.p);
    CHECK_INT(memory.live, 0);
}

/* Each allocation of a contact with pairs fails in turn, and nothing is left behind. */
static void test_no_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    boxes b = boxes_stacked(SB_TET4, 2, 2, 0.04);
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact_def = touching(SB_CONTACT_ORGANS, 0);
    sb_contact *contact = NULL;
    sb_result result = SB_ERROR_MEMORY;
    int nodes, cells, live, fails = 0;
    sb_mesh mesh = boxes_mesh(&b, &nodes, &cells);
    sb_body *body;
    def.mesh = &mesh;
    def.material = pile_material();
    def.allocator = allocator;
    body = scene_body(&def);
    contact_def.body = body;
    live = memory.live; /* the body may keep its list of parts besides */
    for (; result != SB_OK && fails < 100; fails++) {
        memory.calls = 0;
        memory.fail_at = fails + 1;
        result = sb_contact_create(&contact_def, &contact, NULL);
        CHECK(result == SB_OK || (result == SB_ERROR_MEMORY && memory.live <= live + 1 && !contact));
    }
    CHECK(fails > 4 && result == SB_OK);
    memory.fail_at = 0;
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    sb_contact_destroy(contact);
    sb_body_destroy(body);
    CHECK_INT(memory.live, 0);
    sb_mesh_free(&mesh);
}

/* With few places faces get fewer samples, and hold all the same; with far too few the step says so. */
static void test_thinned(void)
{
    boxes b = boxes_stacked(SB_TET4, 3, 4, 0.04);
    for (int few = 0; few < 2; few++) {
        sb_body_def def = sb_default_body_def();
        sb_contact_def contact = touching(SB_CONTACT_ORGANS, 0.5);
        int nodes, cells;
        sb_mesh mesh = boxes_mesh(&b, &nodes, &cells);
        press p;
        def.material = pile_material();
        def.gravity = sb_v3(0, 0, REAL(-9.81));
        contact.max_contacts = few ? 64 : 300;
        p = press_make(mesh, def, contact);
        scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
        for (int i = 0; i < (few ? 1 : 50); i++)
            CHECK_RESULT(sb_body_step(p.body, REAL(0.01), NULL), few ? SB_ERROR_MEMORY : SB_OK);
        if (!few) {
            CHECK(sb_contact_get_info(p.contact).thinned);
            CHECK(force_on(&p, cells).z > REAL(0.2));
        }
        press_free(&p);
    }
}

static void test_refused(void)
{
    sb_body_def def = sb_default_body_def();
    sb_mesh mesh = scene_box(SB_TET4, 1, 1, 1, sb_v3(1, 1, 1), 0);
    sb_contact_def contact = sb_default_contact_def();
    sb_contact *made = NULL;
    def.mesh = &mesh;
    def.material = pile_material();
    contact.body = scene_body(&def);
    contact.pairs = 4;
    CHECK_RESULT(sb_contact_create(&contact, &made, NULL), SB_ERROR_ARGUMENT);
    contact.pairs = SB_CONTACT_SELF;
    contact.pair_friction = -1;
    CHECK_RESULT(sb_contact_create(&contact, &made, NULL), SB_ERROR_ARGUMENT);
    contact.pair_friction = 0;
    contact.pair_distance = -1;
    CHECK_RESULT(sb_contact_create(&contact, &made, NULL), SB_ERROR_ARGUMENT);
    CHECK(made == NULL);
    sb_body_destroy(contact.body);
    sb_mesh_free(&mesh);
}

/* ---- what a step does not foresee ---- */

/* Organs at rest some way apart, one of which is led against the other all at once: they press on each other in the
 * same step, though nothing said so before. Returns how many samples do, and what a step before had looked at. */
static int meet_by_surprise(sb_element_type type, int *looked_at)
{
    const double side = 0.04, cell = side / 3;
    boxes b = boxes_stacked(type, 3, 3, side);
    sb_body_def def = sb_default_body_def();
    sb_vec3 down = {0, 0, REAL(-0.2 * cell)};
    int nodes, cells, pressed;
    press p;
    b.at.z = REAL(side + 0.15 * cell);
    def.material = pile_material();
    p = press_make(boxes_mesh(&b, &nodes, &cells), def, touching(SB_CONTACT_ORGANS, 0.2));
    for (int i = 0; i < sb_body_node_count(p.body); i++)
        if (i >= nodes || p.mesh.nodes[i].z < REAL(1e-3 * side))
            sb_body_fix_nodes(p.body, &i, 1, SB_XYZ);
    for (int i = 0; i < 2; i++)
        CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
    *looked_at = sb_contact_get_info(p.contact).candidates;
    for (int i = nodes; i < sb_body_node_count(p.body); i++)
        CHECK_OK(sb_body_prescribe(p.body, &i, 1, SB_XYZ, &down, 1));
    CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
    pressed = sb_contact_get_info(p.contact).touching;
    CHECK_INT(sb_contact_get_info(p.contact).retries, 0);
    press_free(&p);
    return pressed;
}

static void test_surprise(void)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8};
    for (int i = 0; i < 3; i++) {
        int looked_at;
        CHECK(meet_by_surprise(types[i], &looked_at) > 20);
        CHECK(i > 0 || looked_at == 0);
    }
}

/* ---- cells inside out ---- */

/* A box that slides on another has friction, but where its cells are inside out: of those at the bottom some have a
 * node inside the box, which goes below their faces. */
static void check_crumpled(int is_crumpled, int *grips, int *slips)
{
    const double side = 0.04, cell = 0.8 * side / 3;
    boxes b = boxes_stacked(SB_TET4, 3, 3, side);
    sb_body_def def = sb_default_body_def();
    sb_contact_point *points;
    sb_vec3 *places;
    int nodes, cells, count, touch;
    press p;
    b.shake = 0;
    b.at.z = REAL(0.999 * side);
    def.material = pile_material();
    p = press_make(boxes_mesh(&b, &nodes, &cells), def, touching(SB_CONTACT_ORGANS, 0.5));
    count = sb_body_node_count(p.body);
    places = (sb_vec3 *)calloc((size_t)count, sizeof *places);
    for (int i = nodes; i < count; i++)
        places[i] = sb_v3(REAL(0.3), 0, REAL(-0.05));
    CHECK_OK(sb_body_set_velocities(p.body, places));
    memset(places, 0, (size_t)count * sizeof *places);
    for (int i = nodes; is_crumpled && i < count; i++) {
        sb_vec3 at = sb_v3_sub(p.mesh.nodes[i], b.at);
        if (fabs((double)at.x - 1.5 * cell) < cell && fabs((double)at.y - 1.5 * cell) < cell &&
            fabs((double)at.z - cell) < 0.5 * cell)
            places[i] = sb_v3(0, 0, REAL(-1.1 * cell));
    }
    CHECK_OK(sb_body_set_displacements(p.body, places));
    CHECK_OK(sb_body_step(p.body, REAL(1e-4), NULL));
    touch = sb_contact_points(p.contact, NULL, 0);
    points = (sb_contact_point *)calloc((size_t)touch + 1, sizeof *points);
    sb_contact_points(p.contact, points, touch);
    for (int k = 0; k < touch; k++) {
        sb_vec3 n = points[k].normal, f = points[k].force, along = sb_v3_madd(f, -sb_v3_dot(f, n), n);
        int grip = sb_v3_norm(along) > REAL(1e-3) * sb_v3_norm(f);
        *grips += grip;
        *slips += !grip;
    }
    free(points);
    free(places);
    press_free(&p);
}

static void test_crumpled(void)
{
    int grips = 0, slips = 0;
    check_crumpled(0, &grips, &slips);
    CHECK(grips > 20);
    CHECK_INT(slips, 0);
    grips = 0;
    check_crumpled(1, &grips, &slips);
    CHECK(grips > 10);
    CHECK(slips > 10);
}

CHECK_SUITE(contact_pairs, {"weight", test_weight}, {"patch test", test_patch}, {"incline", test_incline},
            {"momentum", test_momentum}, {"thrown", test_thrown}, {"folded", test_folded}, {"curled", test_curled},
            {"static", test_static}, {"changed", test_changed}, {"threads", test_threads}, {"saved", test_saved},
            {"recorded", test_recorded}, {"undo", test_undo}, {"no allocation in steps", test_no_allocation},
            {"no memory", test_no_memory}, {"thinned", test_thinned}, {"refused", test_refused},
            {"by surprise", test_surprise}, {"crumpled", test_crumpled});
