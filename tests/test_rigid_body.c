/* Rigid bodies with mass that nodes hang on and that move freely: tops, plates in beams, weights on bars, flight, and
 * all that steps, states, recordings and changes of the mesh do with them. */
#include "check.h"
#include "random_case.h"

/* A bar along x, its left end held, and a rigid body on its right end. */
typedef struct tip {
    sb_mesh mesh;
    sb_body *body;
    int *nodes, count; /* of the right end */
    int id;
    double length, across;
} tip;

typedef struct tip_options {
    sb_element_type type;
    int cells;
    double length, across, mass, inertia;
    int held;
    sb_body_def def;
} tip_options;

static tip_options tip_default(void)
{
    tip_options o;
    o.type = SB_HEX8;
    o.cells = 6;
    o.length = 0.6;
    o.across = 0.1;
    o.mass = 2;
    o.inertia = 0.01;
    o.held = 1;
    o.def = sb_default_body_def();
    o.def.material = sb_material_linear(REAL(1e5), 0, 1000);
    o.def.tolerance = REAL(scene_tolerance(1e-12, 64));
    return o;
}

static sb_mat3 diagonal(double a, double b, double c)
{
    sb_mat3 m = sb_m3_zero();
    m.m[0][0] = REAL(a), m.m[1][1] = REAL(b), m.m[2][2] = REAL(c);
    return m;
}

static int *end_nodes(const sb_mesh *mesh, double x, int *count)
{
    int *nodes = (int *)malloc((size_t)mesh->node_count * sizeof(int));
    *count = 0;
    for (int i = 0; i < mesh->node_count && nodes; i++)
        if (fabs((double)mesh->nodes[i].x - x) < 1e-6)
            nodes[(*count)++] = i;
    return nodes;
}

/* Where the tip's rigid body begins: a little beyond the bar's end, turned. */
static sb_rigid_def tip_def(const tip *t, const tip_options *o)
{
    sb_rigid_def def = sb_default_rigid_def();
    def.mass = REAL(o->mass);
    def.inertia = diagonal(o->inertia, 1.5 * o->inertia, 2 * o->inertia);
    def.centre = sb_v3(REAL(1.1 * o->length), REAL(0.4 * o->across), REAL(0.7 * o->across));
    def.turn = sb_quat_make(2, 1, 0, REAL(0.5));
    def.nodes = t->nodes;
    def.node_count = t->count;
    return def;
}

static int tip_make(tip *t, tip_options *o)
{
    sb_rigid_def def;
    memset(t, 0, sizeof *t);
    t->length = o->length;
    t->across = o->across;
    t->mesh = scene_box(o->type, o->cells, 2, 2, sb_v3(REAL(o->length), REAL(o->across), REAL(o->across)), 0);
    o->def.mesh = &t->mesh;
    t->body = scene_body(&o->def);
    t->nodes = end_nodes(&t->mesh, o->length, &t->count);
    if (!CHECK(t->body && t->nodes && t->count > 8))
        return 0;
    if (o->held)
        scene_fix_plane(t->body, &t->mesh, 0, 0, SB_XYZ);
    def = tip_def(t, o);
    return CHECK_OK(sb_body_add_rigid(t->body, &def, &t->id, NULL));
}

static void tip_free(tip *t)
{
    sb_body_destroy(t->body);
    sb_mesh_free(&t->mesh);
    free(t->nodes);
}

static sb_rigid_motion motion_of(const sb_body *body, int id)
{
    sb_rigid_motion motion;
    memset(&motion, 0, sizeof motion);
    CHECK_OK(sb_body_rigid_motion(body, id, &motion));
    return motion;
}

/* How far nodes are from where their rigid body has them, over the distance from its centre; arms: places in its frame.
 */
static double slack_of(const sb_body *body, int id, const int *nodes, int count, const sb_vec3 *arms)
{
    sb_rigid_motion motion = motion_of(body, id);
    double worst = 0;
    for (int i = 0; i < count; i++) {
        sb_vec3 at = sb_v3_add(motion.centre, sb_quat_rotate(motion.turn, arms[i]));
        worst =
            fmax(worst, (double)(sb_v3_norm(sb_v3_sub(sb_body_positions(body)[nodes[i]], at)) / sb_v3_norm(arms[i])));
    }
    return worst;
}

static sb_vec3 *arms_of(const sb_body *body, int id, const int *nodes, int count)
{
    sb_vec3 *arms = (sb_vec3 *)malloc((size_t)count * sizeof *arms);
    sb_rigid_motion motion = motion_of(body, id);
    for (int i = 0; i < count && arms; i++)
        arms[i] =
            sb_quat_rotate(sb_quat_conjugate(motion.turn), sb_v3_sub(sb_body_positions(body)[nodes[i]], motion.centre));
    return arms;
}

/* ---- a top ---- */

/* A symmetric top that nothing acts on: with A across and C along its axis, L its angular momentum and s its spin along
 * the axis it is at exp(t L / A) R0 exp(t s (1 - C / A) e3). Returns the angle that it is off at the end; momentum: how
 * much of L has changed. */
static double top_error(sb_integrator integrator, int steps, double *momentum)
{
    const double across = 2e-3, along = 3.2e-3, spin = 20, tilt = 4, time = 0.5;
    sb_mesh mesh = scene_box(SB_TET4, 1, 1, 1, sb_v3(1, 1, 1), 0);
    sb_body_def body_def = sb_default_body_def();
    sb_rigid_def def = sb_default_rigid_def();
    sb_quat start = sb_quat_normalise(sb_quat_make(3, 1, -1, 2)), wanted, off;
    sb_vec3 w = sb_v3(REAL(tilt), 0, REAL(spin)), whole, now;
    sb_rigid_motion motion;
    sb_body *body;
    int id = 0;
    body_def.mesh = &mesh;
    body_def.material = sb_material_corotated(1000, REAL(0.3), 1000);
    body_def.integrator = integrator;
    body = scene_body(&body_def);
    def.mass = 3;
    def.inertia = diagonal(across, across, along);
    def.turn = start;
    def.spin = sb_quat_rotate(start, w);
    def.velocity = sb_v3(1, 2, 3);
    CHECK_OK(sb_body_add_rigid(body, &def, &id, NULL));
    for (int k = 0; k < steps; k++)
        CHECK_OK(sb_body_step(body, REAL(time / steps), NULL));
    motion = motion_of(body, id);
    whole = sb_quat_rotate(start, sb_v3(REAL(across * tilt), 0, REAL(along * spin)));
    wanted = sb_quat_mul(
        sb_quat_from_rotation_vector(sb_v3_scale(REAL(time / across), whole)),
        sb_quat_mul(start, sb_quat_from_rotation_vector(sb_v3(0, 0, REAL(time * spin * (1 - along / across))))));
    now = sb_quat_rotate(sb_quat_conjugate(motion.turn), motion.spin);
    now = sb_quat_rotate(motion.turn, sb_v3(REAL(across) * now.x, REAL(across) * now.y, REAL(along) * now.z));
    *momentum = (double)(sb_v3_norm(sb_v3_sub(now, whole)) / sb_v3_norm(whole));
    off = sb_quat_mul(sb_quat_conjugate(wanted), motion.turn);
    for (int axis = 0; axis < 3; axis++)
        CHECK_NEAR(scene_component(motion.centre, axis), time * (axis + 1), scene_tolerance(1e-12, 1e3));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return 2 * asin(fmin(1, (double)sb_v3_norm(sb_v3(off.x, off.y, off.z))));
}

static void test_top(void)
{
    static const sb_integrator kinds[] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA};
    static const char *const names[] = {"Euler", "Newmark", "generalised alpha"};
    for (int k = 0; k < 3; k++) {
        double momentum[2], coarse = top_error(kinds[k], 400, momentum), fine = top_error(kinds[k], 800, momentum + 1);
        printf("  top, %s: %.3g rad off after 10 rad of spin in 400 steps, %.3g in 800; momentum %.1e, %.1e\n",
               names[k], coarse, fine, momentum[0], momentum[1]);
        if (k == 0) {
            CHECK(fine < 0.6 * coarse && fine < 0.2);
            CHECK_NEAR(momentum[1], 0, scene_tolerance(1e-12, 1e4)); /* it keeps it */
        } else if (sizeof(sb_real) == 8) {
            CHECK(fine < 0.27 * coarse && fine < 2e-3);
            CHECK(momentum[1] < 1e-4);
        }
    }
}

/* ---- plates and weights ---- */

/* Long steps of Euler's scheme: equilibrium. */
static int settle(sb_body *body, int steps)
{
    int ok = 1;
    for (int k = 0; k < steps && ok; k++) {
        sb_step_info info;
        ok = CHECK_OK(sb_body_step(body, REAL(1e6), &info));
        if (!ok)
            printf("  step %d: %s\n", k, info.error.message);
    }
    return ok;
}

/* A beam with a rigid plate for its middle third, and one with a stiff middle. */
static void test_plate(void)
{
    double tips[2][3] = {{0, 0, 0}, {0, 0, 0}};
    sb_rigid_motion motion;
    memset(&motion, 0, sizeof motion);
    for (int stiff = 0; stiff < (SB_REAL_IS_FLOAT ? 1 : 2); stiff++) { /* float solves nothing 1e5 times as stiff */
        const double length = 0.9, across = 0.1, load = 1e-3;
        sb_mesh mesh = scene_box(SB_HEX8, 18, 2, 2, sb_v3(REAL(length), REAL(across), REAL(across)), 0);
        sb_body_def def = sb_default_body_def();
        sb_body *body;
        int *end, count, inner = 0, *middle = (int *)malloc((size_t)mesh.node_count * sizeof(int));
        int *regions = (int *)calloc((size_t)mesh.element_count, sizeof(int));
        sb_vec3 sum = sb_v3(0, 0, 0);
        for (int e = 0; e < mesh.element_count; e++) {
            double x = 0;
            for (int a = 0; a < 8; a++)
                x += (double)mesh.nodes[mesh.elements[8 * e + a]].x / 8;
            regions[e] = x > length / 3 && x < 2 * length / 3;
        }
        mesh.regions = regions;
        for (int i = 0; i < mesh.node_count; i++)
            if ((double)mesh.nodes[i].x > length / 3 - 1e-6 && (double)mesh.nodes[i].x < 2 * length / 3 + 1e-6)
                middle[inner++] = i;
        def.mesh = &mesh;
        def.material = sb_material_corotated(REAL(1e5), REAL(0.3), 10);
        def.tolerance = REAL(scene_tolerance(1e-12, 64));
        def.max_iterations = 5000;
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        end = end_nodes(&mesh, length, &count);
        for (int i = 0; i < count; i++) {
            sb_vec3 f = sb_v3(REAL(load), REAL(-2 * load), REAL(load));
            CHECK_OK(sb_body_apply_forces(body, end + i, 1, &f, 1, NULL));
        }
        if (stiff) {
            sb_material hard = sb_material_corotated(REAL(1e10), REAL(0.3), 10);
            CHECK_OK(sb_body_set_region_material(body, 1, &hard, NULL));
        } else {
            sb_rigid_def rigid = sb_default_rigid_def();
            int id;
            rigid.mass = REAL(0.01);
            rigid.inertia = diagonal(1e-5, 1e-5, 1e-5);
            rigid.centre = sb_v3(REAL(length / 2), REAL(across / 2), REAL(across / 2));
            rigid.nodes = middle;
            rigid.node_count = inner;
            CHECK_OK(sb_body_add_rigid(body, &rigid, &id, NULL));
            settle(body, 12);
            motion = motion_of(body, id);
        }
        if (stiff)
            settle(body, 12);
        for (int i = 0; i < count; i++)
            sum = sb_v3_add(sum, sb_body_displacements(body)[end[i]]);
        for (int axis = 0; axis < 3; axis++)
            tips[stiff][axis] = (double)scene_component(sum, axis) / count;
        sb_body_destroy(body);
        free(end);
        free(middle);
        sb_mesh_free(&mesh);
    }
    printf("  plate: tip at %.6g %.6g %.6g, with a stiff middle (not in float) at %.6g %.6g %.6g\n", tips[0][0],
           tips[0][1], tips[0][2], tips[1][0], tips[1][1], tips[1][2]);
    for (int axis = 0; axis < 3 && !SB_REAL_IS_FLOAT; axis++)
        CHECK_NEAR(tips[0][axis], tips[1][axis], 1e-4 * fabs(tips[1][1]));
}

/* The wrench of the tissue is the load that it holds, by any bodies, about the centre where it has gone; nodes stay
 * where the rigid body has them. */
static void test_wrench(void)
{
    static const sb_element_type types[] = {SB_TET4, SB_HEX8, SB_TET10};
    for (int k = 0; k < 6; k++) {
        tip_options o = tip_default();
        tip t;
        const sb_vec3 force = sb_v3(REAL(0.3), REAL(-0.5), REAL(0.2)),
                      torque = sb_v3(REAL(0.02), REAL(0.01), REAL(-0.03));
        sb_vec3 *arms;
        sb_rigid_motion motion;
        int linear = k < 3;
        o.type = types[k % 3];
        o.def.material = linear ? sb_material_corotated(REAL(1e5), REAL(0.3), 1000)
                                : sb_material_neo_hookean(REAL(1e5), REAL(0.3), 1000);
        o.def.newton_tolerance = REAL(scene_tolerance(1e-11, 64));
        o.def.gravity = sb_v3(0, 0, REAL(-0.1));
        o.mass = 1;
        if (!tip_make(&t, &o))
            return;
        arms = arms_of(t.body, t.id, t.nodes, t.count);
        CHECK_OK(sb_body_set_rigid_load(t.body, t.id, force, torque));
        settle(t.body, linear ? 30 : 6);
        motion = motion_of(t.body, t.id);
        for (int axis = 0; axis < 3; axis++) {
            double wanted = -(double)scene_component(force, axis) + (axis == 2 ? 0.1 * o.mass : 0);
            CHECK_NEAR(scene_component(motion.force, axis), wanted, scene_tolerance(1e-10, 1e5));
            CHECK_NEAR(scene_component(motion.torque, axis), -(double)scene_component(torque, axis),
                       scene_tolerance(1e-10, 1e5));
        }
        CHECK_NEAR(slack_of(t.body, t.id, t.nodes, t.count, arms), 0, scene_tolerance(1e-12, 64));
        CHECK(fabs((double)motion.turn.w) < 1 && (double)sb_v3_norm(sb_body_displacements(t.body)[t.nodes[0]]) > 1e-4);
        free(arms);
        tip_free(&t);
    }
}

/* ---- a weight on a bar ---- */

/* A weight that hangs on a bar of nu 0: stretch and frequency w of (w L/c) tan(w L/c) = mass of the bar / that of the
 * weight, c^2 = E / rho. */
static void test_bar(void)
{
    tip_options o = tip_default();
    tip t;
    const double young = 1e5, length = o.length, area = o.across * o.across, density = 2, gravity = 0.5;
    const double mass = 2, stiffness = young * area / length;
    double ratio = density * area * length / mass, beta = sqrt(ratio), omega, stretch, rest, last = 0;
    double dt, zeros[64];
    int zero_count = 0;
    o.def.material = sb_material_linear(REAL(young), 0, REAL(density));
    o.mass = mass;
    o.cells = 12;
    if (!tip_make(&t, &o))
        return;
    CHECK_OK(sb_body_remove_rigid(t.body, t.id));
    CHECK_INT(sb_body_rigid_count(t.body), 0);
    {
        sb_rigid_def def = sb_default_rigid_def();
        def.mass = REAL(mass);
        def.inertia = diagonal(1, 1, 1);
        def.centre = sb_v3(REAL(length), REAL(0.5 * o.across), REAL(0.5 * o.across));
        def.nodes = t.nodes;
        def.node_count = t.count;
        CHECK_OK(sb_body_add_rigid(t.body, &def, &t.id, NULL));
    }
    CHECK_OK(sb_body_set_gravity(t.body, sb_v3(REAL(gravity), 0, 0)));
    settle(t.body, 4);
    rest = (double)motion_of(t.body, t.id).centre.x - length;
    stretch = mass * gravity / stiffness * (1 + ratio / 2);
    CHECK_NEAR(rest, stretch, scene_tolerance(1e-9, 1e5) * stretch);
    CHECK_NEAR(motion_of(t.body, t.id).force.x, -mass * gravity, scene_tolerance(1e-10, 1e5));
    tip_free(&t);
    /* it begins at rest, unstretched: the periods of Newmark's scheme, 2/dt atan(w dt/2) */
    o.def.integrator = SB_NEWMARK;
    if (!tip_make(&t, &o))
        return;
    CHECK_OK(sb_body_remove_rigid(t.body, t.id));
    {
        sb_rigid_def def = sb_default_rigid_def();
        def.mass = REAL(mass);
        def.inertia = diagonal(1, 1, 1);
        def.centre = sb_v3(REAL(length), REAL(0.5 * o.across), REAL(0.5 * o.across));
        def.nodes = t.nodes;
        def.node_count = t.count;
        CHECK_OK(sb_body_add_rigid(t.body, &def, &t.id, NULL));
    }
    CHECK_OK(sb_body_set_gravity(t.body, sb_v3(REAL(gravity), 0, 0)));
    for (int k = 0; k < 40; k++) /* Newton's method for beta tan beta = ratio */
        beta -= (beta * tan(beta) - ratio) / (tan(beta) + beta / (cos(beta) * cos(beta)));
    omega = beta / length * sqrt(young / density);
    dt = 2 * 3.141592653589793 / omega / 100;
    for (int k = 0; k < 1050; k++) {
        double now;
        CHECK_OK(sb_body_step(t.body, REAL(dt), NULL));
        now = (double)motion_of(t.body, t.id).centre.x - length - rest;
        if (last < 0 && now >= 0 && zero_count < 64)
            zeros[zero_count++] = dt * (k - now / (now - last));
        last = now;
    }
    if (CHECK(zero_count > 8)) {
        double measured = 2 * 3.141592653589793 * (zero_count - 1) / (zeros[zero_count - 1] - zeros[0]);
        double wanted = 2 / dt * atan(omega * dt / 2);
        printf("  weight on a bar: stretch %.9g m for %.9g, frequency %.8g rad/s for %.8g\n", rest, stretch, measured,
               wanted);
        CHECK_NEAR(measured, wanted, 2e-5 * wanted);
    }
    tip_free(&t);
}

/* ---- flight ---- */

/* Of a body of tet4 and its rigid body. */
static sb_vec3 momentum_of(const tip *t, double mass, double density)
{
    sb_vec3 sum = sb_v3_scale(REAL(mass), motion_of(t->body, t->id).velocity);
    for (int e = 0; e < t->mesh.element_count; e++)
        for (int a = 0; a < 4; a++)
            sum = sb_v3_madd(sum, REAL(density / 4) * sb_mesh_element_volume(&t->mesh, e),
                             sb_body_velocities(t->body)[t->mesh.elements[4 * e + a]]);
    return sum;
}

/* Tissue on a rigid body that flies and turns under a load on it: momentum is the load's, whatever the scheme; without
 * load and damping its turning keeps energy and angular momentum as well as the scheme does. */
static void test_flight(void)
{
    static const sb_integrator kinds[] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA};
    for (int k = 0; k < 6; k++) {
        tip_options o = tip_default();
        tip t;
        sb_rigid_def def;
        sb_vec3 *arms, before, after, force = sb_v3(REAL(0.3), REAL(-0.2), REAL(0.4));
        const double dt = 1e-3;
        double size;
        o.type = SB_TET4;
        o.held = 0;
        o.def.integrator = kinds[k % 3];
        o.def.material = k < 3 ? sb_material_corotated(REAL(1e4), REAL(0.3), 1000)
                               : sb_material_neo_hookean(REAL(1e4), REAL(0.3), 1000);
        o.def.newton_tolerance = REAL(scene_tolerance(1e-12, 64));
        if (!tip_make(&t, &o))
            return;
        CHECK_OK(sb_body_remove_rigid(t.body, t.id));
        def = tip_def(&t, &o);
        def.velocity = sb_v3(2, -1, REAL(0.5));
        def.spin = sb_v3(1, 3, -2);
        CHECK_OK(sb_body_add_rigid(t.body, &def, &t.id, NULL));
        CHECK_OK(sb_body_set_rigid_load(t.body, t.id, force, sb_v3(REAL(0.1), 0, 0)));
        arms = arms_of(t.body, t.id, t.nodes, t.count);
        before = momentum_of(&t, o.mass, 1000);
        size = (double)sb_v3_norm(before);
        for (int i = 0; i < 200; i++)
            if (!CHECK_OK(sb_body_step(t.body, REAL(dt), NULL)))
                break;
        after = momentum_of(&t, o.mass, 1000);
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(sb_v3_sub(after, before), sb_v3_scale(REAL(200 * dt), force))), 0,
                   scene_tolerance(1e-8, 1e5) * size);
        CHECK_NEAR(slack_of(t.body, t.id, t.nodes, t.count, arms), 0, scene_tolerance(1e-12, 64));
        CHECK(scene_all_finite(sb_body_positions(t.body), t.mesh.node_count));
        free(arms);
        tip_free(&t);
    }
}

/* All nodes hang on one that turns by 90 degrees: no energy in the tissue, and none of its stiffness in the way. */
static void test_quarter(void)
{
    for (int k = 0; k < 6; k++) {
        static const sb_integrator kinds[] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA};
        sb_mesh mesh = scene_box(k < 3 ? SB_HEX20 : SB_TET4, 3, 2, 2, sb_v3(REAL(0.3), REAL(0.2), REAL(0.2)), 0.2);
        sb_body_def body_def = sb_default_body_def();
        sb_rigid_def def = sb_default_rigid_def();
        sb_energy energy = {1, 1, 1};
        const double quarter = 1.5707963267948966;
        sb_rigid_motion motion;
        int *all = (int *)malloc((size_t)mesh.node_count * sizeof(int)), id = 0;
        sb_body *body;
        for (int i = 0; i < mesh.node_count; i++)
            all[i] = i;
        body_def.mesh = &mesh;
        body_def.integrator = kinds[k % 3];
        body_def.material = k % 2 ? sb_material_neo_hookean(REAL(1e4), REAL(0.3), 1000)
                                  : sb_material_corotated(REAL(1e4), REAL(0.3), 1000);
        body = scene_body(&body_def);
        def.mass = 1000; /* the nodes' own inertia is next to nothing */
        def.inertia = diagonal(4e4, 4e4, 4e4);
        def.centre = sb_v3(REAL(0.1), REAL(0.1), REAL(0.1));
        def.spin = sb_v3(0, 0, REAL(quarter));
        def.nodes = all;
        def.node_count = mesh.node_count;
        CHECK_OK(sb_body_add_rigid(body, &def, &id, NULL));
        for (int i = 0; i < 20; i++)
            CHECK_OK(sb_body_step(body, REAL(0.05), NULL));
        motion = motion_of(body, id);
        CHECK_OK(sb_body_energy(body, &energy));
        CHECK_NEAR(energy.elastic, 0,
                   scene_tolerance(k % 2 ? 1e-16 : 1e-20, k % 2 ? 0.01 : 1e3 * (double)SB_EPSILON) * 1e4);
        CHECK_NEAR(2 * atan2((double)motion.turn.z, (double)motion.turn.w), quarter, 1e-3);
        for (int i = 0; i < mesh.node_count; i++) {
            sb_vec3 arm = sb_v3_sub(mesh.nodes[i], def.centre),
                    to = sb_v3_add(motion.centre, sb_quat_rotate(motion.turn, arm));
            CHECK_NEAR(sb_v3_norm(sb_v3_sub(to, sb_body_positions(body)[i])), 0, scene_tolerance(1e-14, 8));
        }
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(all);
    }
}

/* ---- states, recordings, threads, failures ---- */

/* Random loads and steps of random length. */
static void play(sb_body *body, int id, unsigned long long *seed, int steps)
{
    for (int k = 0; k < steps; k++) {
        CHECK_OK(sb_body_set_rigid_load(body, id, sb_v3_scale(REAL(0.5), random_direction(seed)),
                                        sb_v3_scale(REAL(0.05), random_direction(seed))));
        CHECK_OK(sb_body_step(body, REAL(check_random_in(seed, 0.004, 0.02)), NULL));
    }
}

static tip_options play_options(int k)
{
    static const sb_integrator kinds[] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA};
    tip_options o = tip_default();
    o.type = k % 2 ? SB_TET4 : SB_HEX8;
    o.def.integrator = kinds[k % 3];
    o.def.gravity = sb_v3(0, 0, REAL(-1));
    o.def.tolerance = REAL(1e-4);
    o.def.material =
        k < 3 ? sb_material_corotated(REAL(1e5), REAL(0.3), 1000) : sb_material_neo_hookean(REAL(1e5), REAL(0.3), 1000);
    o.mass = 0.5;
    return o;
}

static void test_state(void)
{
    for (int k = 0; k < 6; k++) {
        tip_options o = play_options(k);
        unsigned long long seed = 5 + (unsigned long long)k, again;
        tip a, b;
        size_t size, none_size;
        void *state, *none;
        uint64_t hash, middle;
        if (!tip_make(&a, &o) || !tip_make(&b, &o))
            return;
        CHECK_OK(sb_body_remove_rigid(b.body, b.id));
        none_size = sb_body_state_size(b.body);
        none = malloc(none_size);
        CHECK_OK(sb_body_state_save(b.body, none, none_size));
        play(a.body, a.id, &seed, 5);
        size = sb_body_state_size(a.body);
        state = malloc(size);
        CHECK_OK(sb_body_state_save(a.body, state, size));
        middle = sb_body_state_hash(a.body);
        again = seed;
        play(a.body, a.id, &seed, 5);
        hash = sb_body_state_hash(a.body);
        CHECK(hash != middle);
        CHECK_OK(sb_body_state_load(a.body, state, size, NULL));
        CHECK(sb_body_state_hash(a.body) == middle);
        seed = again;
        play(a.body, a.id, &seed, 5);
        CHECK(sb_body_state_hash(a.body) == hash);
        CHECK_OK(sb_body_state_load(b.body, state, size, NULL)); /* it has none of its own */
        CHECK_INT(sb_body_rigid_count(b.body), 1);
        seed = again;
        play(b.body, a.id, &seed, 5);
        CHECK(sb_body_state_hash(b.body) == hash);
        CHECK_OK(sb_body_state_load(b.body, none, none_size, NULL));
        CHECK_INT(sb_body_rigid_count(b.body), 0);
        sb_body_reset(a.body);
        CHECK_NEAR(motion_of(a.body, a.id).centre.x, 1.1 * o.length, scene_tolerance(1e-15, 4));
        CHECK_OK(sb_body_step(a.body, REAL(0.01), NULL));
        free(state);
        free(none);
        tip_free(&a);
        tip_free(&b);
    }
}

static void test_record(void)
{
    for (int k = 0; k < 6; k++) {
        tip_options o = play_options(k);
        unsigned long long seed = 11;
        tip a, b;
        sb_rigid_def def;
        sb_recording *recording = NULL;
        sb_recording_report report;
        int other = 0;
        if (!tip_make(&a, &o) || !tip_make(&b, &o))
            return;
        CHECK_OK(sb_recording_start(a.body, 1, NULL, &recording, NULL));
        play(a.body, a.id, &seed, 3);
        def = tip_def(&a, &o);
        def.nodes = NULL;
        def.node_count = 0;
        CHECK_OK(sb_body_add_rigid(a.body, &def, &other, NULL));
        play(a.body, other, &seed, 2);
        CHECK_OK(sb_body_remove_rigid(a.body, a.id));
        play(a.body, other, &seed, 2);
        sb_recording_stop(recording);
        if (!CHECK_OK(sb_recording_replay(recording, b.body, &report)))
            printf("%s\n", report.error.message);
        CHECK_INT(report.steps, 7);
        CHECK(sb_body_state_hash(a.body) == sb_body_state_hash(b.body));
        sb_recording_destroy(recording);
        tip_free(&a);
        tip_free(&b);
    }
}

static void test_threads(void)
{
    for (int k = 0; k < 6; k++) {
        uint64_t hash[3];
        for (int w = 0; w < 3; w++) {
            static const int counts[] = {1, 2, 3};
            int workers = counts[w];
            tip_options o = play_options(k);
            unsigned long long seed = 3;
            tip t;
            o.cells = 24;
            if (w > 0)
                o.def.jobs = scene_jobs(&workers);
            if (!tip_make(&t, &o))
                return;
            play(t.body, t.id, &seed, 4);
            hash[w] = sb_body_state_hash(t.body);
            tip_free(&t);
        }
        CHECK(hash[0] == hash[1] && hash[0] == hash[2]);
    }
}

/* A step that fails leaves all as it was, to the last bit. */
static void test_undo(void)
{
    for (int k = 0; k < 6; k++) {
        tip_options o = play_options(k);
        unsigned long long seed = 9;
        tip t;
        sb_step_info info;
        uint64_t hash;
        sb_vec3 none = sb_v3(0, 0, 0);
        if (!tip_make(&t, &o))
            return;
        play(t.body, t.id, &seed, 3);
        CHECK_OK(sb_body_set_rigid_load(t.body, t.id, none, sb_v3(REAL(1e9), 0, 0)));
        hash = sb_body_state_hash(t.body);
        check_bad_numbers();
        if (CHECK(sb_body_step(t.body, REAL(0.1), &info) != SB_OK) && k < 3) {
            CHECK_RESULT(info.error.result, SB_ERROR_DIVERGED);
            CHECK(strstr(info.error.message, "rigid body") != NULL);
        }
        CHECK(sb_body_state_hash(t.body) == hash);
        CHECK_OK(sb_body_set_rigid_load(t.body, t.id, none, none));
        CHECK_OK(sb_body_step(t.body, REAL(0.01), NULL));
        tip_free(&t);
    }
}

static void test_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    tip_options o = play_options(1);
    sb_result result = SB_ERROR_MEMORY;
    sb_rigid_def def;
    tip t;
    unsigned long long seed = 1;
    int failures = 0, id = 0, live;
    size_t size;
    void *state;
    o.def.allocator = scene_allocator(&memory);
    if (!tip_make(&t, &o))
        return;
    size = sb_body_state_size(t.body);
    state = malloc(size);
    CHECK_OK(sb_body_state_save(t.body, state, size));
    CHECK_OK(sb_body_remove_rigid(t.body, t.id));
    live = memory.live;
    for (int n = 1; result != SB_OK && n < 100; n++) { /* a state with one, into a body without */
        uint64_t hash = sb_body_state_hash(t.body);
        memory.calls = 0;
        memory.fail_at = n;
        result = sb_body_state_load(t.body, state, size, NULL);
        memory.fail_at = 0;
        if (result == SB_OK)
            break;
        CHECK_RESULT(result, SB_ERROR_MEMORY);
        CHECK(sb_body_state_hash(t.body) == hash);
        CHECK_INT(memory.live, live);
    }
    CHECK_OK(result);
    free(state);
    memory.calls = 0;
    play(t.body, t.id, &seed, 2);
    CHECK_INT(memory.calls, 0);
    CHECK_OK(sb_body_remove_rigid(t.body, t.id));
    sb_body_destroy(t.body);
    t.body = scene_body(&o.def);
    def = tip_def(&t, &o);
    result = SB_ERROR_MEMORY;
    for (int n = 1; result != SB_OK && n < 100; n++) {
        uint64_t hash = sb_body_state_hash(t.body);
        live = memory.live;
        memory.calls = 0;
        memory.fail_at = n;
        result = sb_body_add_rigid(t.body, &def, &id, NULL);
        memory.fail_at = 0;
        failures += result == SB_ERROR_MEMORY;
        if (result == SB_OK)
            break;
        CHECK_RESULT(result, SB_ERROR_MEMORY);
        CHECK(memory.live <= live + 2); /* an empty list, and room of the solver's, may stay */
        CHECK(sb_body_state_hash(t.body) == hash);
    }
    CHECK_OK(result);
    CHECK(failures > 2);
    memory.calls = 0;
    play(t.body, id, &seed, 4);
    CHECK_INT(memory.calls, 0);
    sb_body_destroy(t.body);
    CHECK_INT(memory.live, 0);
    t.body = NULL;
    tip_free(&t);
}

static void test_errors(void)
{
    tip_options o = play_options(1);
    tip t;
    sb_rigid_def def, bad;
    sb_error error;
    sb_rigid_motion motion;
    sb_constraint_term terms[2];
    uint64_t hash;
    int id = -7, twice[2], outside[2] = {0, 1 << 20}, held[1] = {-1}, hung;
    const sb_vec3 nowhere = sb_v3(0, REAL(NAN), 0), none = sb_v3(0, 0, 0);
    if (!tip_make(&t, &o))
        return;
    CHECK_OK(sb_body_step(t.body, REAL(0.01), NULL));
    def = tip_def(&t, &o);
    hash = sb_body_state_hash(t.body);
    hung = t.nodes[0];
    CHECK_RESULT(sb_body_add_rigid(t.body, &def, &id, &error), SB_ERROR_ARGUMENT); /* they hang already */
    CHECK(error.node == t.nodes[0] && strstr(error.message, "hangs on rigid body"));
    CHECK_RESULT(sb_body_hold(t.body, &hung, 1, SB_X, &error), SB_ERROR_ARGUMENT);
    memset(terms, 0, sizeof terms);
    terms[0].node = hung, terms[0].coefficient = 1;
    terms[1].node = t.nodes[1], terms[1].coefficient = 1;
    CHECK_RESULT(sb_body_add_constraint(t.body, terms, 2, 0, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_set_rigid_load(t.body, 99, none, none), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_set_rigid_load(NULL, t.id, none, none), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_rigid_motion(t.body, 99, &motion), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_rigid_motion(t.body, t.id, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_remove_rigid(t.body, 99), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_remove_rigid(NULL, t.id), SB_ERROR_ARGUMENT);
    CHECK_INT(sb_body_rigid_count(NULL), 0);
    def.nodes = NULL, def.node_count = 0;
    for (int i = 0; i < t.mesh.node_count && held[0] < 0; i++)
        held[0] = (double)t.mesh.nodes[i].x < 1e-9 ? i : -1;
    twice[0] = twice[1] = held[0];
    for (int i = 0; i < t.mesh.node_count; i++)
        if (fabs((double)t.mesh.nodes[i].x - 0.3) < 1e-6)
            twice[0] = twice[1] = i;
    bad = def, bad.nodes = outside, bad.node_count = 2;
    CHECK_RESULT(sb_body_add_rigid(t.body, &bad, &id, &error), SB_ERROR_INDEX);
    bad.nodes = held, bad.node_count = 1;
    CHECK_RESULT(sb_body_add_rigid(t.body, &bad, &id, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "supported") != NULL);
    bad.nodes = twice, bad.node_count = 2;
    CHECK_RESULT(sb_body_add_rigid(t.body, &bad, &id, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "twice") != NULL);
    bad = def, bad.mass = 0;
    CHECK_RESULT(sb_body_add_rigid(t.body, &bad, &id, &error), SB_ERROR_ARGUMENT);
    bad = def, bad.inertia.m[0][1] = REAL(1e-3);
    CHECK_RESULT(sb_body_add_rigid(t.body, &bad, &id, &error), SB_ERROR_ARGUMENT);
    bad = def, bad.inertia = diagonal(1, -1, 1);
    CHECK_RESULT(sb_body_add_rigid(t.body, &bad, &id, &error), SB_ERROR_ARGUMENT);
    bad = def, bad.turn = sb_quat_make(0, 0, 0, 0);
    CHECK_RESULT(sb_body_add_rigid(t.body, &bad, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_rigid(NULL, &def, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_rigid(t.body, NULL, &id, &error), SB_ERROR_ARGUMENT);
    check_bad_numbers();
    bad = def, bad.centre = nowhere;
    CHECK_RESULT(sb_body_add_rigid(t.body, &bad, &id, &error), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_body_set_rigid_load(t.body, t.id, nowhere, none), SB_ERROR_NOT_FINITE);
    CHECK_INT(id, -7);
    CHECK(sb_body_state_hash(t.body) == hash);
    for (int k = 1; k < SB_MAX_RIGID; k++)
        CHECK_OK(sb_body_add_rigid(t.body, &def, &id, &error));
    CHECK_RESULT(sb_body_add_rigid(t.body, &def, &id, &error), SB_ERROR_UNSUPPORTED);
    CHECK_OK(sb_body_step(t.body, REAL(0.01), NULL));
    tip_free(&t);
    o.def.integrator = SB_CENTRAL_DIFFERENCE;
    o.held = 0;
    t.mesh = scene_box(SB_TET4, 2, 2, 2, sb_v3(1, 1, 1), 0);
    o.def.mesh = &t.mesh;
    t.body = scene_body(&o.def);
    t.nodes = NULL;
    CHECK_RESULT(sb_body_add_rigid(t.body, &def, &id, &error), SB_ERROR_UNSUPPORTED);
    tip_free(&t);
}

CHECK_SUITE(rigid_body, {"a symmetric top", test_top}, {"two beams joined by a plate", test_plate},
            {"the wrench is the load", test_wrench}, {"a weight on a bar", test_bar}, {"flight", test_flight},
            {"a quarter turn", test_quarter}, {"states", test_state}, {"recordings", test_record},
            {"threads", test_threads}, {"a failed step is undone", test_undo}, {"memory", test_memory},
            {"errors", test_errors});
