/* What bodies hang on, and what they are strained by: cables (ligaments, sutures), clamps moved by poses, rigid bodies
 * with mass, prestress. */
#include "verification_scene.h"

static const double exact = 1e-8, young = 1e4;

/* ---- cables ---- */

/* A cube of 1 kg/l about the origin of nodes, its middle node among them, hung on a cable to `hook`. */
typedef struct hung_cube {
    sb_mesh mesh;
    sb_body *body;
    int middle, cable;
    double mass;
} hung_cube;

static int cube_make(hung_cube *c, const verify_element *element, double edge, sb_vec3 hook, double stiffness,
                     sb_real gravity)
{
    sb_body_def def;
    sb_cable_def cable = sb_default_cable_def();
    sb_vec3 places[2];
    int path[2] = {-1, -1};
    memset(c, 0, sizeof *c);
    c->mesh = scene_box(element->type, 2, 2, 2, sb_v3(REAL(edge), REAL(edge), REAL(edge)), 0);
    for (int i = 0; i < c->mesh.node_count; i++) {
        sb_vec3 *x = c->mesh.nodes + i;
        *x = sb_v3_sub(*x, sb_v3(REAL(edge / 2), REAL(edge / 2), REAL(edge / 2)));
        if (sb_v3_norm(*x) < REAL(1e-6 * edge))
            path[0] = i;
    }
    c->middle = path[0];
    def = verify_def(&c->mesh, element, sb_material_corotated(REAL(1e7), REAL(0.3), 1000));
    def.integrator = SB_NEWMARK;
    def.max_newton = 10;
    def.gravity = sb_v3(0, 0, -gravity);
    c->body = scene_body(&def);
    c->mass = 1000 * edge * edge * edge;
    places[0] = sb_v3(0, 0, 0), places[1] = hook;
    cable.count = 2, cable.nodes = path, cable.places = places, cable.stiffness = REAL(stiffness);
    return CHECK(c->middle >= 0) && CHECK_OK(sb_body_add_cable(c->body, &cable, &c->cable, NULL));
}

static void cube_free(hung_cube *c)
{
    sb_body_destroy(c->body);
    sb_mesh_free(&c->mesh);
}

/* Let go from the cable's rest length, a mass falls by 2 m g / k within half a period 2 pi sqrt(m / k). */
static void test_bobbing(void)
{
    const double edge = 0.1, length = 0.5, gravity = 9.81, stiffness = 500;
    const double period = 2 * VERIFY_PI * sqrt(1000 * edge * edge * edge * length / stiffness);
    static const char *const names[] = {"tet4", "hex8", "hex20"};
    for (int k = 0; k < 3; k++) {
        const int steps = 100;
        double deepest = 0, last = 0;
        hung_cube c;
        if (!cube_make(&c, verify_element_named(names[k]), edge, sb_v3(0, 0, REAL(length)), stiffness, REAL(gravity)))
            return;
        for (int i = 0; i < steps; i++) {
            CHECK_OK(sb_body_step(c.body, REAL(period / steps), NULL));
            last = (double)sb_body_displacements(c.body)[c.middle].z;
            deepest = fmin(deepest, last);
        }
        verify("cube let go on an elastic cable", names[k], "2 m g / k", "deepest (m)",
               -2 * c.mass * gravity * length / stiffness, deepest, 1.2e-5);
        verify("cube let go on an elastic cable, after a period 2 pi sqrt(m/k)", names[k], "returns to where it began",
               "way left / (2 m g / k)", 0, last / (2 * c.mass * gravity * length / stiffness), 5e-5);
        cube_free(&c);
    }
}

/* A mass on a stiff cable swings as a pendulum of the cable's length: held at the middle node, nothing turns it. */
static void test_pendulum(void)
{
    const double edge = 0.1, length = 1, gravity = 9.81, angle = 0.02;
    const double period = 2 * VERIFY_PI * sqrt(length / gravity);
    static const char *const names[] = {"tet4", "hex8"};
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("small swings on a stiff cable need double");
        return;
    }
    for (int k = 0; k < 2; k++) {
        const int steps = 200;
        hung_cube c;
        double most = 0;
        sb_vec3 hook = sb_v3(REAL(length * sin(angle)), 0, REAL(length * cos(angle)));
        if (!cube_make(&c, verify_element_named(names[k]), edge, hook, 1e5, REAL(gravity)))
            return;
        for (int i = 0; i < steps; i++) {
            CHECK_OK(sb_body_step(c.body, REAL(period / steps), NULL));
            if (i == steps / 2 - 1)
                most = (double)sb_body_displacements(c.body)[c.middle].x;
        }
        verify("cube on a cable, let go 0.02 rad aside, after half a period 2 pi sqrt(l/g)", names[k],
               "mathematical pendulum", "way across (m)", 2 * length * sin(angle), most, 1.6e-4);
        verify("cube on a cable, let go 0.02 rad aside, after a period", names[k], "mathematical pendulum",
               "way left / (2 l sin a)", 0,
               (double)sb_body_displacements(c.body)[c.middle].x / (2 * length * sin(angle)), 1.8e-4);
        cube_free(&c);
    }
}

/* One cable through the middle of a weight, from two hooks of other heights: the same tension on both sides. */
static void test_thread(void)
{
    static const char *const names[] = {"tet4", "tet10", "hex8", "hex20", "hex27"};
    for (int k = 0; k < 5; k++) {
        const double edge = 0.1, gravity = 9.81, mass = 1;
        const verify_element *element = verify_element_named(names[k]);
        sb_mesh mesh = scene_box(element->type, 2, 2, 2, sb_v3(REAL(edge), REAL(edge), REAL(edge)), 0);
        sb_body *body = verify_body(&mesh, element, sb_material_corotated(REAL(1e6), REAL(0.3), 1000));
        sb_cable_def def = sb_default_cable_def();
        int path[3] = {-1, -1, -1}, id = 0;
        sb_vec3 places[3], at[3], forces[3], ways[2];
        sb_real tension = 0;
        for (int i = 0; i < mesh.node_count; i++) {
            sb_vec3 x = sb_v3_sub(mesh.nodes[i], sb_v3(REAL(edge / 2), REAL(edge / 2), REAL(edge / 2)));
            if (sb_v3_norm(x) < REAL(1e-6 * edge))
                path[1] = i;
            else if (fabs((double)x.x) > 0.4 * edge) /* it neither turns nor swings */
                CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_X | SB_Y));
        }
        places[0] = sb_v3(REAL(-0.2), REAL(edge / 2), REAL(0.3)), places[1] = sb_v3(0, 0, 0);
        places[2] = sb_v3(REAL(0.5), REAL(edge / 2), REAL(0.2));
        def.count = 3, def.nodes = path, def.places = places, def.stiffness = REAL(100 * mass * gravity);
        CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, REAL(-gravity))));
        CHECK_OK(sb_body_add_cable(body, &def, &id, NULL));
        verify_solve(body);
        CHECK_OK(sb_body_cable_tension(body, id, &tension));
        CHECK_OK(sb_body_cable_points(body, id, at));
        CHECK_OK(sb_body_cable_forces(body, id, forces));
        ways[0] = sb_v3_sub(at[0], at[1]), ways[1] = sb_v3_sub(at[2], at[1]);
        verify("weight on a thread that slides through it, hooks of two heights", names[k],
               "N (h1/l1 + h2/l2) is the weight", "N (h1/l1 + h2/l2) (N)", mass * gravity,
               (double)tension *
                   ((double)ways[0].z / (double)sb_v3_norm(ways[0]) + (double)ways[1].z / (double)sb_v3_norm(ways[1])),
               exact);
        verify("weight on a thread that slides through it", names[k], "no friction",
               "tension at the one hook over that at the other", 1,
               (double)(sb_v3_norm(forces[0]) / sb_v3_norm(forces[2])), exact);
        verify_free(body, &mesh);
    }
}

/* ---- clamps ---- */

/* Two clamps turn the ends of a shaft against each other: M = G pi r^4 / 2 angle / length, by wrenches about its axis.
 */
static void test_shaft(void)
{
    static const char *const names[] = {"hex8", "hex8", "hex20"};
    static const int across[] = {8, 16, 8};
    static const double bounds[] = {0.09, 0.025, 0.09}; /* flat cells: the round is not filled */
    for (int k = 0; k < 3; k++) {
        const verify_element *element = verify_element_named(names[k]);
        const double radius = 0.1, length = 0.8, angle = 1e-4, poisson = 0.3;
        char name[80];
        double modulus = young / (2 * (1 + poisson)), wanted;
        sb_mesh straight, mesh;
        sb_body *body;
        sb_vec3 torques[2], forces[2], ends[2];
        memset(&straight, 0, sizeof straight);
        CHECK_OK(sb_mesh_cylinder(sb_element_straight(element->type), 0, REAL(radius), REAL(length), across[k], 4, NULL,
                                  &straight, NULL));
        mesh = straight;
        if (element->type == SB_HEX20)
            CHECK_OK(sb_mesh_to_hex20(&straight, NULL, &mesh, NULL));
        if (element->type == SB_HEX27)
            CHECK_OK(sb_mesh_to_hex27(&straight, NULL, &mesh, NULL));
        body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(poisson), 1000));
        for (int end = 0; end < 2; end++) {
            int *nodes = (int *)malloc((size_t)mesh.node_count * sizeof(int)), count = 0;
            ends[end] = sb_v3(REAL(length * end), 0, 0);
            for (int i = 0; i < mesh.node_count && nodes; i++)
                if (fabs((double)mesh.nodes[i].x - length * end) < 1e-6)
                    nodes[count++] = i;
            CHECK_OK(sb_body_place_rigid(body, nodes, count, ends[end], ends[end],
                                         sb_quat_from_rotation_vector(sb_v3(REAL(angle * (end - 0.5)), 0, 0)), NULL));
            free(nodes);
        }
        verify_solve(body);
        for (int end = 0; end < 2; end++) {
            int *nodes = (int *)malloc((size_t)mesh.node_count * sizeof(int)), count = 0;
            for (int i = 0; i < mesh.node_count && nodes; i++)
                if (fabs((double)mesh.nodes[i].x - length * end) < 1e-6)
                    nodes[count++] = i;
            CHECK_OK(sb_body_wrench(body, nodes, count, ends[end], forces + end, torques + end, NULL));
            free(nodes);
        }
        wanted = modulus * VERIFY_PI * pow(radius, 4) / 2 * angle / length;
        snprintf(name, sizeof name, "shaft twisted by two clamps, %d flat cells over its diameter", across[k]);
        verify(name, names[k], "M = G pi r^4/2 angle/length", "torque of a clamp (N m)", wanted, (double)torques[1].x,
               bounds[k]);
        verify("shaft twisted by two clamps", names[k], "balance", "sum of both clamps' torques / M", 0,
               (double)(torques[0].x + torques[1].x) / wanted, exact);
        verify("shaft twisted by two clamps", names[k], "balance", "sum of both clamps' forces / (M/r)", 0,
               (double)sb_v3_norm(sb_v3_add(forces[0], forces[1])) * radius / wanted, exact);
        if (mesh.nodes != straight.nodes)
            sb_mesh_free(&straight);
        verify_free(body, &mesh);
    }
}

/* ---- rigid bodies ---- */

/* Nodes from x = low to x = high, to be freed. */
static int *slab_nodes(const sb_mesh *mesh, double low, double high, int *count)
{
    int *nodes = (int *)malloc((size_t)mesh->node_count * sizeof(int));
    *count = 0;
    for (int i = 0; i < mesh->node_count && nodes; i++)
        if ((double)mesh->nodes[i].x > low - 1e-6 && (double)mesh->nodes[i].x < high + 1e-6)
            nodes[(*count)++] = i;
    return nodes;
}

/* A body whose long steps of implicit Euler are equilibria. */
static sb_body *resting_body(const sb_mesh *mesh, const verify_element *element, sb_material material)
{
    sb_body_def def = verify_def(mesh, element, material);
    sb_body *body;
    def.integrator = SB_EULER;
    def.max_newton = 1;
    def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-12);
    def.max_iterations = 20000;
    body = scene_body(&def);
    scene_fix_plane(body, mesh, 0, 0, SB_XYZ);
    return body;
}

static void rest(sb_body *body)
{
    for (int i = 0; i < 6; i++)
        CHECK_OK(sb_body_step(body, REAL(1e6), NULL));
}

static int add_rigid(sb_body *body, const sb_mesh *mesh, double low, double high, double mass, double inertia,
                     sb_vec3 centre)
{
    sb_rigid_def def = sb_default_rigid_def();
    int id = 0, *nodes = slab_nodes(mesh, low, high, &def.node_count);
    def.mass = REAL(mass);
    def.inertia = sb_m3_scale(REAL(inertia), sb_m3_identity());
    def.centre = centre;
    def.nodes = nodes;
    CHECK_OK(sb_body_add_rigid(body, &def, &id, NULL));
    free(nodes);
    return id;
}

/* A cantilever whose middle third is rigid, with a load across at its end. Timoshenko's beam: of each elastic part what
 * bends and shears under the load and its moment. */
static void test_plate(void)
{
    static const char *const names[] = {"tet10", "hex20", "hex27"};
    const double length = 0.9, height = 0.06, load = 1e-7, a = 0.3, b = 0.6;
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("forces far smaller than their parts need double");
        return;
    }
    for (int k = 0; k < 3; k++) {
        const verify_element *element = verify_element_named(names[k]);
        sb_mesh mesh = scene_box(element->type, 18, 1, 1, sb_v3(REAL(length), REAL(height), REAL(height)), 0);
        sb_body *body = resting_body(&mesh, element, sb_material_linear(REAL(young), 0, 1));
        double inertia = pow(height, 4) / 12, area = height * height, across = 0, moved = 0;
        double wanted = load / (3 * young * inertia) * (pow(length, 3) - pow(length - a, 3) + pow(length - b, 3)) +
                        load * (a + length - b) / (5.0 / 6 * young / 2 * area);
        sb_rigid_motion motion;
        int id = add_rigid(body, &mesh, a, b, 1e-3, 1e-6, sb_v3(REAL(length / 2), REAL(height / 2), REAL(height / 2)));
        int count, *end = slab_nodes(&mesh, length, length, &count);
        sb_vec3 force = sb_v3(0, 0, REAL(load / count));
        CHECK_OK(sb_body_apply_forces(body, end, count, &force, 1, NULL));
        rest(body);
        CHECK_OK(sb_body_rigid_motion(body, id, &motion));
        for (int i = 0; i < count; i++)
            moved += (double)sb_body_displacements(body)[end[i]].z / count;
        for (int i = 0; i < mesh.node_count; i++)
            across += (double)sb_body_reactions(body)[i].z;
        verify("cantilever with a rigid middle third", names[k], "Timoshenko beam", "deflection of its end (m)", wanted,
               moved, 0.02);
        verify("cantilever with a rigid middle third", names[k], "balance", "reaction of the clamp (N)", -load, across,
               exact);
        verify("cantilever with a rigid middle third", names[k], "balance", "force on the rigid body / load", 0,
               (double)sb_v3_norm(motion.force) / load, exact);
        free(end);
        verify_free(body, &mesh);
    }
}

/* A torque on a rigid end, in one static solve: an arc of a circle, which the end goes on from straight. Even and
 * shaken meshes. */
static void test_arc(void)
{
    static const char *const names[] = {"tet10", "hex20", "hex27"};
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("forces far smaller than their parts need double");
        return;
    }
    for (int k = 0; k < 6; k++) {
        const verify_element *element = verify_element_named(names[k % 3]);
        const double length = 1, side = 0.1, arc = 0.8, angle = 1.25, torque = angle * young * pow(side, 4) / 12 / arc;
        const char *name = k < 3 ? "bar bent by a torque on its rigid end, 10x2x2"
                                 : "bar bent by a torque on its rigid end, 10x2x2 shaken";
        sb_vec3 size = sb_v3(REAL(length), REAL(side), REAL(side));
        sb_mesh even = scene_box(element->type, 10, 2, 2, size, 0);
        sb_mesh mesh = scene_box(element->type, 10, 2, 2, size, k < 3 ? 0 : 0.15);
        sb_body_def def = verify_def(&mesh, element, sb_material_corotated(REAL(young), 0, 1000));
        sb_body *body = scene_body(&def);
        sb_rigid_motion motion;
        sb_static_options options = sb_default_static_options();
        sb_vec3 *shape = mesh.nodes;
        int id;
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        mesh.nodes = even.nodes; /* which of them hang */
        id = add_rigid(body, &mesh, arc, length, 1, 1, sb_v3(REAL(0.9), REAL(side / 2), REAL(side / 2)));
        mesh.nodes = shape;
        CHECK_OK(sb_body_set_rigid_load(body, id, sb_v3(0, 0, 0), sb_v3(0, REAL(-torque), 0)));
        options.tolerance = REAL(1e-9);
        CHECK_OK(sb_body_solve_static(body, &options, NULL));
        CHECK_OK(sb_body_rigid_motion(body, id, &motion));
        verify(name, names[k % 3], "Euler: x = l sin a/a + h cos a", "place of the end (m)",
               arc * sin(angle) / angle + 0.1 * cos(angle), (double)motion.centre.x, 0.005);
        verify(name, names[k % 3], "Euler: z = l (1 - cos a)/a + h sin a", "place of the end (m)",
               arc * (1 - cos(angle)) / angle + 0.1 * sin(angle), (double)motion.centre.z - side / 2, 0.005);
        verify(name, names[k % 3], "balance", "force on the rigid body / (M/l)", 0,
               (double)sb_v3_norm(motion.force) * arc / torque, exact);
        verify(name, names[k % 3], "balance", "torque on the rigid body (N m)", torque, (double)motion.torque.y, exact);
        sb_mesh_free(&even);
        verify_free(body, &mesh);
    }
}

/* A weight at the end of a bar of nu 0 that weighs next to nothing: stretch m g L / (E A), and its frequency, by
 * Newmark's scheme: 2/dt atan(w dt/2) of w tan(w L/c) = c rho A / m. */
static void test_weight(void)
{
    static const char *const names[] = {"hex8", "hex20", "tet4"};
    for (int k = 0; k < 3; k++) {
        const verify_element *element = verify_element_named(names[k]);
        const double length = 0.6, side = 0.1, mass = 2, density = 2, gravity = 0.05;
        double area = side * side, ratio = density * area * length / mass, beta = sqrt(ratio), omega, dt;
        double first = -1, last = -1, before = 0, stretch = mass * gravity * length / (young * area) * (1 + ratio / 2);
        int periods = -1;
        sb_mesh mesh = scene_box(element->type, 12, 1, 1, sb_v3(REAL(length), REAL(side), REAL(side)), 0);
        sb_vec3 centre = sb_v3(REAL(length), REAL(side / 2), REAL(side / 2));
        sb_material material = sb_material_linear(REAL(young), 0, REAL(density));
        sb_body *body = resting_body(&mesh, element, material);
        sb_body_def def = verify_def(&mesh, element, material);
        sb_rigid_motion motion;
        int id = add_rigid(body, &mesh, length, length, mass, 1, centre);
        CHECK_OK(sb_body_set_gravity(body, sb_v3(REAL(gravity), 0, 0)));
        rest(body);
        CHECK_OK(sb_body_rigid_motion(body, id, &motion));
        verify("weight on a bar", names[k], "m g L/(E A)", "stretch (m)", stretch, (double)motion.centre.x - length,
               exact);
        verify("weight on a bar", names[k], "balance", "force on the weight (N)", -mass * gravity,
               (double)motion.force.x, exact);
        sb_body_destroy(body);
        def.integrator = SB_NEWMARK;
        def.max_newton = 1;
        def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-10);
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        id = add_rigid(body, &mesh, length, length, mass, 1, centre);
        CHECK_OK(sb_body_set_gravity(body, sb_v3(REAL(gravity), 0, 0)));
        for (int i = 0; i < 40; i++)
            beta -= (beta * tan(beta) - ratio) / (tan(beta) + beta / (cos(beta) * cos(beta)));
        omega = beta / length * sqrt(young / density);
        dt = 2 * VERIFY_PI / omega / 60;
        for (int i = 0; i < 640; i++) {
            double now;
            CHECK_OK(sb_body_step(body, REAL(dt), NULL));
            CHECK_OK(sb_body_rigid_motion(body, id, &motion));
            now = (double)motion.centre.x - length - stretch;
            if (before < 0 && now >= 0) {
                last = dt * (i - now / (now - before));
                first = first < 0 ? last : first;
                periods++;
            }
            before = now;
        }
        if (!SB_REAL_IS_FLOAT)
            verify("weight on a bar", names[k], "w tan(w L/c) = c rho A/m, Newmark's 2/dt atan(w dt/2)",
                   "frequency (rad/s)", 2 / dt * atan(omega * dt / 2), 2 * VERIFY_PI * periods / (last - first), 3e-4);
        verify_free(body, &mesh);
    }
}

/* A symmetric top that nothing acts on: R = exp(t L/A) R0 exp(t s (1 - C/A) e3). */
static void test_top(void)
{
    static const sb_integrator kinds[] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA};
    static const char *const names[] = {"implicit Euler", "Newmark", "generalised alpha"};
    static const double bounds[] = {0.03, 4e-5, 6e-5};
    const double across = 2e-3, along = 3.2e-3, spin = 20, tilt = 4, time = 0.5;
    const int steps = 400;
    for (int k = 0; k < 3; k++) {
        const verify_element *element = verify_element_named("tet4");
        sb_mesh mesh = scene_box(SB_TET4, 1, 1, 1, sb_v3(1, 1, 1), 0);
        sb_body_def body_def = verify_def(&mesh, element, sb_material_corotated(REAL(young), 0, 1000));
        sb_rigid_def def = sb_default_rigid_def();
        sb_rigid_motion motion;
        sb_quat wanted, off;
        sb_vec3 whole, now;
        sb_body *body;
        int id = 0;
        body_def.integrator = kinds[k];
        body = scene_body(&body_def);
        def.mass = 1;
        def.inertia.m[0][0] = def.inertia.m[1][1] = REAL(across);
        def.inertia.m[2][2] = REAL(along);
        def.turn = sb_quat_normalise(sb_quat_make(3, 1, -1, 2));
        def.spin = sb_quat_rotate(def.turn, sb_v3(REAL(tilt), 0, REAL(spin)));
        CHECK_OK(sb_body_add_rigid(body, &def, &id, NULL));
        for (int i = 0; i < steps; i++)
            CHECK_OK(sb_body_step(body, REAL(time / steps), NULL));
        CHECK_OK(sb_body_rigid_motion(body, id, &motion));
        whole = sb_quat_rotate(def.turn, sb_v3(REAL(across * tilt), 0, REAL(along * spin)));
        wanted = sb_quat_mul(
            sb_quat_from_rotation_vector(sb_v3_scale(REAL(time / across), whole)),
            sb_quat_mul(def.turn, sb_quat_from_rotation_vector(sb_v3(0, 0, REAL(time * spin * (1 - along / across))))));
        off = sb_quat_mul(sb_quat_conjugate(wanted), motion.turn);
        now = sb_quat_rotate(sb_quat_conjugate(motion.turn), motion.spin);
        now = sb_quat_rotate(motion.turn, sb_v3(REAL(across) * now.x, REAL(across) * now.y, REAL(along) * now.z));
        if (!SB_REAL_IS_FLOAT)
            verify("top that spins by 10 rad and precesses, 400 steps", names[k], "exp(t L/A) R0 exp(t s (1 - C/A) e3)",
                   "angle that it is off (rad)", 0, 2 * asin(fmin(1, (double)sb_v3_norm(sb_v3(off.x, off.y, off.z)))),
                   bounds[k]);
        if (k == 0)
            verify("top that spins by 10 rad and precesses, 400 steps", names[k], "nothing acts on it",
                   "change of its angular momentum / itself", 0,
                   (double)(sb_v3_norm(sb_v3_sub(now, whole)) / sb_v3_norm(whole)), exact);
        verify_free(body, &mesh);
    }
}

/* ---- prestress ---- */

/* Uniform prestretch in a block held all round, distorted within: it stays, and a side holds P(G) G^T / det G. */
static void test_prestress(void)
{
    static const double l[3] = {1.15, 0.98, 1.04};
    for (int m = 0; m < VERIFY_MATERIALS; m++) {
        const verify_material *law = verify_materials + m;
        sb_material plain = law->make(REAL(young), REAL(0.3), 1000);
        double stress[3], wanted, worst = 0, moved = 0, computed = 0;
        sb_mat3 g = sb_m3_zero();
        if (!sb_material_is_hyperelastic(plain.model))
            continue;
        law->principal(verify_constants_of(young, 0.3), l, stress);
        wanted = stress[0] * l[0] / (l[0] * l[1] * l[2]) * 0.6 * 0.5;
        for (int i = 0; i < 3; i++)
            g.m[i][i] = REAL(l[i]);
        computed = wanted;
        for (int e = 0; e < VERIFY_ELEMENTS; e++) {
            sb_mesh mesh;
            sb_body *body;
            double force = 0;
            if (!verify_suits(verify_elements + e, plain.model))
                continue;
            mesh = scene_box(verify_elements[e].type, 3, 2, 2, sb_v3(2, REAL(0.6), REAL(0.5)), 0.2);
            body = verify_body(&mesh, verify_elements + e, sb_material_with_prestretch(plain, g));
            scene_fix_boundary(body, &mesh);
            verify_solve(body);
            for (int i = 0; i < mesh.node_count; i++)
                if ((double)mesh.nodes[i].x > 1.999)
                    force += (double)sb_body_reactions(body)[i].x;
            moved = verify_worse(moved, scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count));
            if (fabs(force - wanted) >= worst) {
                worst = fabs(force - wanted);
                computed = force;
            }
            verify_free(body, &mesh);
        }
        verify("block held all round, prestretch 1.15, 0.98, 1.04, distorted", law->name, "P(G) G^T / det G",
               "force on a side (N)", wanted, computed, exact);
        verify("block held all round, prestretch 1.15, 0.98, 1.04, distorted", law->name, "uniform stress balances",
               "largest way of a node (m)", 0, moved, exact);
    }
}

/* The same where only rigid motion is held: it relaxes to F = G^-1. */
static void test_relaxed(void)
{
    static const double l[3] = {1.1, 0.95, 1.05};
    for (int m = 0; m < VERIFY_MATERIALS; m++) {
        sb_material plain = verify_materials[m].make(REAL(young), REAL(0.3), 1000);
        sb_mesh mesh = scene_box(m % 2 ? SB_TET10 : SB_HEX8, 3, 2, 2, sb_v3(2, REAL(0.6), REAL(0.5)), 0.2);
        sb_mat3 g = sb_m3_zero();
        sb_body *body;
        double worst = 0;
        for (int i = 0; i < 3; i++)
            g.m[i][i] = REAL(l[i]);
        if (sb_material_is_hyperelastic(plain.model)) {
            body = verify_body(&mesh, verify_element_named(m % 2 ? "tet10" : "hex8"),
                               sb_material_with_prestretch(plain, g));
            scene_fix_plane(body, &mesh, 0, 0, SB_X);
            scene_fix_plane(body, &mesh, 1, 0, SB_Y);
            scene_fix_plane(body, &mesh, 2, 0, SB_Z);
            verify_solve(body);
            for (int i = 0; i < mesh.node_count; i++) {
                sb_vec3 x = mesh.nodes[i], at = sb_body_positions(body)[i];
                for (int k = 0; k < 3; k++)
                    worst = verify_worse(worst,
                                         fabs((double)scene_component(at, k) - (double)scene_component(x, k) / l[k]));
            }
            verify("free block, prestretch 1.1, 0.95, 1.05, distorted", verify_materials[m].name,
                   "shape without stress F = G^-1", "largest distance from it (m)", 0, worst, exact);
            sb_body_destroy(body);
        }
        sb_mesh_free(&mesh);
    }
}

static void test_table(void) { verify_table("verification_attached"); }

CHECK_SUITE(verification_attached, {"bobbing", test_bobbing}, {"pendulum", test_pendulum}, {"thread", test_thread},
            {"shaft", test_shaft}, {"rigid plate", test_plate}, {"arc", test_arc}, {"weight", test_weight},
            {"top", test_top}, {"prestress", test_prestress}, {"relaxed", test_relaxed}, {"table", test_table});
