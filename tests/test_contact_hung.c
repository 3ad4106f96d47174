/* test_contact_hung: tools that hang on their pose by a spring. */
#include <math.h>

#define SB_SPLIT_BUILD
#include "../src/softbody/contact/contact_private.h"

#include "contact_scene.h"

/* What rounding of places makes of the forces of contact and of a spring (N): next to nothing in double, and in float
 * what a surface ten times as stiff as the tissue, or a stiff spring, makes of a few nanometres. */
static double rounding(const press *p)
{
    sb_vec3 low, high;
    double springs = 0, place;
    sb_mesh_bounds(&p->mesh, &low, &high);
    place = (double)sb_max(sb_v3_norm(low), sb_v3_norm(high));
    for (int t = 0; t < p->contact->max_tools; t++)
        springs += (double)p->contact->tools[t].spring.stiffness;
    return 2 * (p->contact->touch.noise + springs * (double)SB_EPSILON * place);
}

/* ---- springs in series ---- */

static const double block_side = 0.04, block_young = 5e3;

/* A block on a floor, uniaxial: its upper face is a spring of E A/H. */
static press block_make(double scale, int iterations)
{
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    sb_real side = REAL(block_side * scale);
    sb_mesh mesh = scene_box(SB_TET4, 4, 4, 4, sb_v3(side, side, side), 0);
    press p;
    def.material = sb_material_linear(REAL(block_young), 0, REAL(1000 / (scale * scale)));
    def.damping_stiffness = REAL(0.02);
    def.tolerance = sb_max(REAL(1e-10), 100 * SB_EPSILON);
    contact.max_iterations = iterations;
    p = press_make(mesh, def, contact);
    scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    return p;
}

/* A plane on a spring of `ratio` times the block's stiffness, sent 4 mm into it. */
static void check_series(double ratio)
{
    const double stiffness = block_young * block_side, way = 0.004;
    sb_tool_def def = press_plane(0, sb_v3(0, 0, REAL(block_side + 1e-4)), 1);
    press p = block_make(1, 20);
    double k = ratio * stiffness, expected = k / (k + stiffness) * way, last = 0, change = 0;
    sb_pose at;
    sb_wrench spring, wrench;
    int tool;
    def.coupling_stiffness = REAL(k);
    tool = press_add(&p, &def);
    press_move(&p, tool, sb_v3(0, 0, REAL(block_side - way)), def.pose.rotation);
    for (int i = 0; i < 150; i++) {
        CHECK_OK(sb_body_step(p.body, REAL(0.02), NULL));
        wrench = press_wrench(&p, tool);
        CHECK_OK(sb_contact_coupling(p.contact, tool, &spring));
        CHECK_NEAR(sb_v3_norm(sb_v3_add(wrench.force, spring.force)), 0,
                   scene_tolerance(1e-7, 1e3) * (double)sb_v3_norm(wrench.force) + rounding(&p));
        change = i > 100 ? fmax(change, fabs((double)wrench.force.z - last)) : 0;
        last = (double)wrench.force.z;
    }
    CHECK_OK(sb_contact_reached(p.contact, tool, &at, NULL));
    CHECK_NEAR(last, stiffness * expected, scene_tolerance(1e-6, 1e3) * stiffness * expected + rounding(&p));
    CHECK_NEAR(block_side - (double)at.position.z, expected, scene_tolerance(1e-6, 1e3) * expected + rounding(&p) / k);
    CHECK(change < scene_tolerance(1e-6, 1e3) * last + 2 * rounding(&p)); /* of either step */
    press_free(&p);
}

static void test_series(void)
{
    check_series(0.01);
    check_series(1);
    check_series(100);
}

/* ---- a sphere on an organ ---- */

static sb_body_def organ_def(void)
{
    sb_body_def def = sb_default_body_def();
    def.material = sb_material_corotated(REAL(5e3), REAL(0.45), 1000);
    def.damping_stiffness = REAL(0.01);
    return def;
}

static press organ_make(sb_body_def def, sb_contact_def contact)
{
    sb_mesh mesh = scene_box(SB_TET4, 10, 10, 4, sb_v3(REAL(0.1), REAL(0.1), REAL(0.04)), 0.1);
    press p = press_make(mesh, def, contact);
    scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    return p;
}

static sb_wrench spring_of(const press *p, int tool)
{
    sb_wrench wrench = {{0, 0, 0}, {0, 0, 0}};
    CHECK_OK(sb_contact_coupling(p->contact, tool, &wrench));
    return wrench;
}

static sb_pose reached_by(const press *p, int tool)
{
    sb_pose pose;
    CHECK_OK(sb_contact_reached(p->contact, tool, &pose, NULL));
    return pose;
}

/* Force, and torque over an arm (m; 0: the tool turns as it is sent to), of spring and surface that are not opposite.
 */
static double imbalance(const press *p, int tool, double arm)
{
    sb_wrench spring = spring_of(p, tool), wrench = press_wrench(p, tool);
    double force = (double)sb_v3_norm(sb_v3_add(spring.force, wrench.force));
    double torque = (double)sb_v3_norm(sb_v3_add(spring.torque, wrench.torque));
    double size = (double)sb_v3_norm(wrench.force);
    force = fmax(0, fmax(force, arm > 0 ? torque / arm : 0) - rounding(p));
    return size > 0 ? force / size : 0;
}

/* Pressed and dragged along over the organ by its springs, of either kind: it balances in each step, and comes to rest
 * without a tremor. */
static void check_drag(double stiffness, double turning, int scheme)
{
    sb_body_def def = organ_def();
    sb_tool_def box = press_box(sb_v3(REAL(0.012), REAL(0.008), REAL(0.006)), 0.004, 0.4,
                                sb_v3(REAL(0.035), REAL(0.05), REAL(0.0462)));
    double worst = 0, change = 0, lift = 0, most;
    sb_vec3 last = {0, 0, 0};
    int tool;
    press p;
    def.integrator = scheme == 1 ? SB_GENERALISED_ALPHA : SB_EULER;
    def.spectral_radius = 0;
    if (scheme == 2)
        def.material = sb_material_neo_hookean(REAL(5e3), REAL(0.45), 1000);
    p = organ_make(def, sb_default_contact_def());
    box.coupling_stiffness = REAL(stiffness);
    box.coupling_turning = REAL(turning);
    tool = press_add(&p, &box);
    for (int i = 0; i < 160; i++) {
        double along = i < 20 ? 0 : i < 60 ? 0.0005 * (i - 20) : 0.02, down = i < 20 ? 0.0003 * i : 0.006;
        press_move(&p, tool, sb_v3(REAL(0.035 + along), REAL(0.05), REAL(0.0462 - down)), sb_quat_identity());
        CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
        worst = fmax(worst, imbalance(&p, tool, turning > 0 ? 0.01 : 0));
        change = i > 140 ? fmax(change, (double)sb_v3_norm(sb_v3_sub(press_wrench(&p, tool).force, last))) : 0;
        last = press_wrench(&p, tool).force;
        lift = fmax(lift, (double)last.z);
    }
    most = rounding(&p);
    if (!CHECK(worst < scene_tolerance(1e-7, 1e3)))
        printf("  off by %g of the force\n", worst);
    if (!CHECK(change < scene_tolerance(1e-4, 10) * lift + most))
        printf("  change %g of %g N, rounding %g\n", change, lift, most);
    CHECK(lift > 0.002 * stiffness || lift > 0.2);
    press_free(&p);
}

static void test_drag(void)
{
    check_drag(300, 0.03, 1);
    if (check_quick())
        return;
    check_drag(3, 0, 0);
    check_drag(3e4, 3, 0);
    check_drag(3, 0.0003, 0);
    check_drag(300, 0.03, 0);
    check_drag(300, 0.03, 2);
}

/* The spring gives at most its force, however far the tool is sent, and the tool stays where the organ gives as much.
 */
static void test_max_force(void)
{
    sb_tool_def def = press_sphere(0.01, 0.2, sb_v3(REAL(0.05), REAL(0.05), REAL(0.0505)));
    press p = organ_make(organ_def(), sb_default_contact_def());
    double most = 0;
    int tool;
    def.coupling_stiffness = 500;
    def.max_force = REAL(0.3);
    tool = press_add(&p, &def);
    for (int i = 0; i < 120; i++) {
        press_move(&p, tool, sb_v3(REAL(0.05), REAL(0.05), REAL(0.0505 - 0.0005 * (i < 60 ? i : 60))),
                   sb_quat_identity());
        CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
        most = fmax(most, (double)sb_v3_norm(spring_of(&p, tool).force));
    }
    CHECK_NEAR(most, 0.3, scene_tolerance(1e-12, 100));
    CHECK_NEAR(sb_v3_norm(press_wrench(&p, tool).force), 0.3, scene_tolerance(1e-8, 1e4));
    CHECK(reached_by(&p, tool).position.z > REAL(0.0405));
    press_free(&p);
}

/* An organ is thrown at a tool on a spring that stands still: neither has more energy afterwards. */
static void check_energy(double stiffness, double friction)
{
    sb_body_def def = organ_def();
    sb_tool_def tool = press_sphere(0.008, friction, sb_v3(REAL(0.014), REAL(0.019), REAL(-0.0085)));
    sb_mesh mesh = scene_box(SB_TET4, 4, 4, 3, sb_v3(REAL(0.03), REAL(0.03), REAL(0.02)), 0.1);
    double start, most = 0;
    sb_vec3 *velocities;
    sb_energy energy;
    int hit = 0, number;
    press p;
    def.damping_stiffness = 0;
    def.tolerance = REAL(1e-6);
    p = press_make(mesh, def, press_exact());
    tool.coupling_stiffness = REAL(stiffness);
    tool.coupling_turning = REAL(1e-4 * stiffness);
    number = press_add(&p, &tool);
    velocities = (sb_vec3 *)malloc((size_t)p.mesh.node_count * sizeof *velocities);
    for (int i = 0; i < p.mesh.node_count; i++)
        velocities[i] = sb_v3(REAL(0.05), 0, REAL(-0.3));
    CHECK_OK(sb_body_set_velocities(p.body, velocities));
    free(velocities);
    CHECK_OK(sb_body_energy(p.body, &energy));
    start = (double)energy.kinetic;
    for (int i = 0; i < 80; i++) {
        sb_wrench spring;
        double all;
        CHECK_OK(sb_body_step(p.body, REAL(0.002), NULL));
        spring = spring_of(&p, number);
        CHECK_OK(sb_body_energy(p.body, &energy));
        all = (double)(energy.elastic + energy.kinetic);
        all += (double)sb_v3_dot(spring.force, spring.force) / (2 * stiffness);
        all += (double)sb_v3_dot(spring.torque, spring.torque) / (2e-4 * stiffness);
        most = fmax(most, all);
        hit |= sb_v3_norm(spring.force) > REAL(0.01);
    }
    CHECK(hit);
    CHECK(most <= start * 1.001);
    press_free(&p);
}

static void test_energy(void)
{
    check_energy(2, 0);
    check_energy(200, 0.3);
    check_energy(2e4, 0.3);
}

/* Between the organ, which is pushed up from below by its supports, and the pose that it is kept at. */
static void test_squeezed(void)
{
    sb_tool_def def = press_sphere(0.008, 0.3, sb_v3(REAL(0.05), REAL(0.05), REAL(0.0482)));
    press p = organ_make(organ_def(), sb_default_contact_def());
    double last = 0;
    int tool;
    def.coupling_stiffness = 50;
    def.coupling_turning = REAL(0.01);
    tool = press_add(&p, &def);
    for (int i = 0; i < 150; i++) {
        sb_vec3 up = sb_v3(0, 0, REAL(0.0004 * (i < 50 ? i : 50)));
        for (int n = 0; n < p.mesh.node_count; n++)
            if (p.mesh.nodes[n].z < REAL(1e-6))
                CHECK_OK(sb_body_prescribe(p.body, &n, 1, SB_XYZ, &up, 1));
        CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
        last = (double)reached_by(&p, tool).position.z - 0.0482;
        CHECK_NEAR(press_wrench(&p, tool).force.z, 50 * last, scene_tolerance(1e-7, 1e4));
    }
    CHECK(last > 0.01 && last < 0.02);
    press_free(&p);
}

/* The scene of springs in series in a static solve; and at other sizes. */
static double series_force(double scale, int is_static)
{
    sb_tool_def def = press_plane(0, sb_v3(0, 0, REAL((block_side + 1e-4) * scale)), 1);
    press p = block_make(scale, 20);
    sb_pose to = press_pose(sb_v3(0, 0, REAL((block_side - 0.004) * scale)), def.pose.rotation);
    double force;
    int tool;
    def.coupling_stiffness = REAL(0.5 * block_young * block_side * scale);
    tool = press_add(&p, &def);
    CHECK_OK(sb_contact_move_tool(p.contact, tool, &to));
    if (is_static)
        CHECK_OK(sb_body_solve_static(p.body, NULL, NULL));
    for (int i = 0; !is_static && i < 40; i++)
        CHECK_OK(sb_body_step(p.body, REAL(0.02), NULL));
    force = (double)press_wrench(&p, tool).force.z / (scale * scale);
    CHECK_NEAR(sb_v3_norm(sb_v3_add(press_wrench(&p, tool).force, spring_of(&p, tool).force)), 0,
               scene_tolerance(1e-7, 1e3) * force * scale * scale + rounding(&p));
    press_free(&p);
    return force;
}

static void test_static(void)
{
    const double stiffness = block_young * block_side, expected = 0.004 * stiffness / 3;
    CHECK_NEAR(series_force(1, 1), expected, 2e-3 * expected);
}

static void test_scale(void)
{
    double force = series_force(1, 0);
    CHECK_NEAR(series_force(1e-3, 0), force, scene_tolerance(1e-9, 1e6) * force);
    CHECK_NEAR(series_force(1e3, 0), force, scene_tolerance(1e-9, 1e6) * force);
}

/* Where constraints eliminate nodes the stiffness of the system is too stiff: the balance is the same. */
static void test_constrained(void)
{
    sb_body_def def = organ_def();
    sb_tool_def tool = press_sphere(0.01, 0.2, sb_v3(REAL(0.05), REAL(0.05), REAL(0.0505)));
    sb_wrench wrench[2];
    for (int tied = 0; tied < 2; tied++) {
        press p = organ_make(def, sb_default_contact_def());
        int number;
        if (tied) { /* far off: two corners of the upper side go along x together */
            sb_constraint_term terms[2] = {{0, 0, 1}, {0, 0, -1}};
            terms[0].node = p.mesh.node_count - 1;
            terms[1].node = p.mesh.node_count - 11;
            CHECK_OK(sb_body_add_constraint(p.body, terms, 2, 0, NULL, NULL));
        }
        tool.coupling_stiffness = 30;
        number = press_add(&p, &tool);
        for (int i = 0; i < 120; i++) {
            press_move(&p, number, sb_v3(REAL(0.05), REAL(0.05), REAL(0.0505 - 0.0005 * (i < 20 ? i : 20))),
                       sb_quat_identity());
            CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
        }
        wrench[tied] = press_wrench(&p, number);
        press_free(&p);
    }
    CHECK_NEAR(wrench[1].force.z, wrench[0].force.z, 0.02 * (double)wrench[0].force.z);
}

/* ---- the stiffness that a tool reads, against differences of steps ---- */

/* Wrench when the last step had taken the tool a little along an axis, or turned it. */
static sb_wrench wrench_after(const press *p, int tool, const void *state, size_t size, sb_pose pose, int axis,
                              double way)
{
    sb_vec3 turn = {0, 0, 0}, moved = {0, 0, 0};
    sb_wrench wrench;
    sb_real *to = axis < 3 ? &moved.x : &turn.x;
    to[axis % 3] = REAL(way);
    CHECK_OK(sb_body_state_load(p->body, state, size, NULL));
    pose.position = sb_v3_add(pose.position, moved);
    pose.rotation = sb_quat_mul(sb_quat_from_rotation_vector(turn), pose.rotation);
    CHECK_OK(sb_contact_move_tool(p->contact, tool, &pose));
    CHECK_OK(sb_body_step(p->body, REAL(0.02), NULL));
    wrench = press_wrench(p, tool);
    return wrench;
}

static void test_stiffness(void)
{
    const double middle = 0.5 * block_side, arm = 0.02, step = sizeof(sb_real) == 8 ? 1e-7 : 2e-5;
    press p = block_make(1, 30);
    sb_tool_def def = press_plane(20, sb_v3(REAL(middle), REAL(middle), REAL(block_side + 1e-4)), 1);
    int tool = press_add(&p, &def);
    sb_real k[6][6];
    size_t size;
    void *state;
    double largest[2] = {0, 0};
    CHECK_RESULT(sb_contact_stiffness(p.contact, tool, k), SB_ERROR_STATE);
    def.pose.position.z = REAL(block_side - 0.002);
    CHECK_OK(sb_contact_move_tool(p.contact, tool, &def.pose));
    for (int i = 0; i < 40; i++)
        CHECK_OK(sb_body_step(p.body, REAL(0.02), NULL));
    size = sb_body_state_size(p.body);
    state = malloc(size);
    CHECK_OK(sb_body_state_save(p.body, state, size));
    CHECK_OK(sb_body_step(p.body, REAL(0.02), NULL));
    CHECK_OK(sb_contact_stiffness(p.contact, tool, k));
    CHECK_RESULT(sb_contact_stiffness(p.contact, 5, k), SB_ERROR_INDEX);
    for (int j = 0; j < 6; j++) {
        double way = j < 3 ? step : step / arm;
        sb_wrench more = wrench_after(&p, tool, state, size, def.pose, j, way);
        sb_wrench less = wrench_after(&p, tool, state, size, def.pose, j, -way);
        sb_vec3 force = sb_v3_scale(REAL(0.5 / way), sb_v3_sub(more.force, less.force));
        sb_vec3 torque = sb_v3_scale(REAL(0.5 / way), sb_v3_sub(more.torque, less.torque));
        double found[6];
        found[0] = (double)force.x, found[1] = (double)force.y, found[2] = (double)force.z;
        found[3] = (double)torque.x, found[4] = (double)torque.y, found[5] = (double)torque.z;
        for (int i = 0; i < 6; i++) {
            double unit = (i < 3 ? 1 : arm) * (j < 3 ? 1 : arm);
            double off = fabs(found[i] - (double)k[i][j]) / unit;
            largest[j / 3] = fmax(largest[j / 3], off);
        }
        CHECK(k[j][j] < 0);
    }
    printf("    of %.4g N/m off by %.3g, of turns by %.3g\n", -(double)k[2][2], largest[0], largest[1]);
    CHECK(largest[0] < scene_tolerance(1e-2, 1e5) * -(double)k[2][2]);
    CHECK(largest[1] < scene_tolerance(1e-2, 1e5) * -(double)k[2][2]);
    free(state);
    press_free(&p);
}

static void test_refused(void)
{
    press p = block_make(1, 4);
    sb_tool_def def = press_sphere(0.01, 0, sb_v3(0, 0, 1));
    int tool;
    def.coupling_stiffness = -1;
    CHECK_RESULT(sb_contact_add_tool(p.contact, &def, &tool, NULL), SB_ERROR_ARGUMENT);
    def.coupling_stiffness = 0;
    def.coupling_turning = 1;
    CHECK_RESULT(sb_contact_add_tool(p.contact, &def, &tool, NULL), SB_ERROR_ARGUMENT);
    def.coupling_stiffness = 1;
    def.max_force = 0;
    CHECK_RESULT(sb_contact_add_tool(p.contact, &def, &tool, NULL), SB_ERROR_ARGUMENT);
    press_free(&p);
}

CHECK_SUITE(contact_hung, {"springs in series", test_series}, {"dragged along", test_drag},
            {"largest force", test_max_force}, {"energy", test_energy}, {"squeezed", test_squeezed},
            {"static", test_static}, {"scale", test_scale}, {"constrained", test_constrained},
            {"stiffness", test_stiffness}, {"refused", test_refused});
