/* test_contact_series: contact against tables: Hertz for finer meshes and other depths, the ripple of what slides over
 * coarse faces, blocks against differences of forces, and
 * energy. CHECK_SLOW=1: the finest meshes too. */
#define SB_SPLIT_BUILD
#include "../src/softbody/contact/contact_private.h"

#include "contact_scene.h"

/* ---- Hertz ----------------------------------------------------------------------------------------------------- */

enum { MOST_LINES = 64 };
static const double hertz_size = 0.3, hertz_radius = 0.1, hertz_young = 5e3, hertz_poisson = 0.3; /* m, m, Pa */

/* Places of the lines of a graded mesh (m): cells of `fine` to 15 mm, then ever larger ones. Returns how many cells. */
static int hertz_lines(double fine, double places[MOST_LINES])
{
    int count = 0;
    double cell = fine;
    places[0] = 0;
    while (places[count] < hertz_size && count + 1 < MOST_LINES) {
        if (places[count] > 0.0149)
            cell *= 1.5;
        places[count + 1] = places[count] + cell;
        count++;
    }
    for (int i = 0; i <= count; i++)
        places[i] *= hertz_size / places[count];
    return count;
}

static press hertz_make(sb_element_type type, double fine)
{
    double places[MOST_LINES];
    int cells = hertz_lines(fine, places);
    sb_mesh straight = scene_box(SB_TET4, cells, cells, cells, sb_v3(1, 1, 1), 0), mesh;
    sb_body_def def = sb_default_body_def();
    press p;
    memset(&mesh, 0, sizeof mesh);
    for (int i = 0; i < straight.node_count; i++) {
        sb_vec3 *x = straight.nodes + i;
        int line[3] = {(int)((double)x->x * cells + 0.5), (int)((double)x->y * cells + 0.5),
                       (int)((1 - (double)x->z) * cells + 0.5)};
        *x = sb_v3(REAL(places[line[0]]), REAL(places[line[1]]), REAL(-places[line[2]]));
    }
    if (type == SB_TET10) {
        CHECK_OK(sb_mesh_to_tet10(&straight, NULL, &mesh, NULL));
        sb_mesh_free(&straight);
    } else {
        mesh = straight;
    }
    def.material = sb_material_linear(REAL(hertz_young), REAL(hertz_poisson), 1000);
    def.tolerance = sb_max(REAL(1e-6), 100 * SB_EPSILON);
    def.max_iterations = 5000;
    p = press_make(mesh, def, press_exact());
    scene_fix_plane(p.body, &p.mesh, 0, 0, SB_X);
    scene_fix_plane(p.body, &p.mesh, 1, 0, SB_Y);
    scene_fix_plane(p.body, &p.mesh, 0, hertz_size, SB_XYZ);
    scene_fix_plane(p.body, &p.mesh, 1, hertz_size, SB_XYZ);
    scene_fix_plane(p.body, &p.mesh, 2, -hertz_size, SB_XYZ);
    return p;
}

/* Force (N) of a sphere pressed so deep (m), of that of Hertz in a block that is held at its size. */
static double hertz_share(const press *p, int tool, double depth)
{
    double a = sqrt(hertz_radius * depth);
    double expected =
        4.0 / 3.0 * hertz_young / (1 - hertz_poisson * hertz_poisson) * a * depth * (1 + 1.04 * a / hertz_size);
    press_move(p, tool, sb_v3(0, 0, REAL(hertz_radius - depth)), sb_quat_identity());
    for (int i = 0; i < 6; i++)
        CHECK_OK(sb_body_step(p->body, 1000, NULL));
    return 4 * (double)press_wrench(p, tool).force.z / expected;
}

static void check_hertz(sb_element_type type, double fine, double pass)
{
    sb_tool_def sphere = press_sphere(hertz_radius, 0, sb_v3(0, 0, REAL(hertz_radius)));
    press p = hertz_make(type, fine);
    int tool = press_add(&p, &sphere);
    double share = hertz_share(&p, tool, 0.001);
    printf("Hertz, %s, h/a %.3f: %+.2f %%\n", sb_element_name(type), fine / 0.01, 100 * (share - 1));
    CHECK_NEAR(share, 1, pass);
    press_free(&p);
}

/* test_contact has tet10 with h/a 0.5. */
static void test_hertz(void)
{
    check_hertz(SB_TET4, 0.0025, 0.1);
    if (getenv("CHECK_SLOW")) {
        check_hertz(SB_TET4, 0.00125, 0.07);
        check_hertz(SB_TET10, 0.0025, 0.02);
    }
}

/* Force goes as the depth to the power of 1.5. */
static void test_slope(void)
{
    sb_tool_def sphere = press_sphere(hertz_radius, 0, sb_v3(0, 0, REAL(hertz_radius)));
    press p = hertz_make(SB_TET10, 0.005);
    int tool = press_add(&p, &sphere);
    double one = hertz_share(&p, tool, 0.001), two = hertz_share(&p, tool, 0.002);
    CHECK_NEAR(1.5 + log(two / one) / log(2), 1.5, 0.03);
    press_free(&p);
}

/* ---- ripple ---------------------------------------------------------------------------------------------------- */

/* What the mesh itself makes: of the mean normal force. */
static const struct {
    sb_element_type type;
    double cell, radius, normal, drag; /* m, m, least of any stiffness */
} ripples[] = {{SB_TET4, 0.1 / 9, 0.01, 0.056, 0.082},
               {SB_TET4, 0.1 / 9, 0.005, 0.097, 0.087},
               {SB_TET4, 0.1 / 18, 0.01, 0.018, 0.024},
               {SB_TET10, 0.1 / 9, 0.01, 0.018, 0.032}};

/* A sphere pressed by half of its radius that slides 30 mm through the middle at 5 cm/s over faces `cell` (m) long. */
static void slide_over(sb_element_type type, double cell, double radius, double *normal, double *drag)
{
    const int first = 80, last = 140;
    const double thick = 0.04, wide = 0.1;
    int cells = (int)(wide / cell + 0.5), layers = (int)(thick / cell + 0.5);
    sb_body_def def = sb_default_body_def();
    sb_tool_def sphere = press_sphere(radius, 0.3, sb_v3(REAL(0.02), REAL(0.05), REAL(thick + radius + 0.0005)));
    double sum[2] = {0, 0}, square[2] = {0, 0};
    press p;
    int tool, count = last - first;
    def.material = sb_material_corotated(REAL(5e3), REAL(0.45), 1000);
    def.damping_stiffness = REAL(0.01);
    p = press_make(scene_box(type, cells, cells, layers, sb_v3(REAL(wide), REAL(wide), REAL(thick)), 0), def,
                   sb_default_contact_def());
    scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    tool = press_add(&p, &sphere);
    for (int i = 1; i <= last; i++) {
        double z = thick + radius + 0.0005 - (0.5 * radius + 0.0005) * (i < 30 ? i : 30) / 30;
        press_move(&p, tool, sb_v3(REAL(0.02 + 0.0005 * (i > 40 ? i - 40 : 0)), REAL(0.05), REAL(z)),
                   sb_quat_identity());
        CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
        for (int k = 0; k < 2 && i > first; k++) {
            double force = (double)(k == 0 ? press_wrench(&p, tool).force.z : press_wrench(&p, tool).force.x);
            sum[k] += force / count;
            square[k] += force * force / count;
        }
    }
    *normal = sqrt(fmax(0, square[0] - sum[0] * sum[0])) / sum[0];
    *drag = sqrt(fmax(0, square[1] - sum[1] * sum[1])) / sum[0];
    printf("ripple, %s, r/h %.2f: %.1f %%, drag %.1f %%\n", sb_element_name(type), radius / cell, 100 * *normal,
           100 * *drag);
    press_free(&p);
}

/* A quarter more than what meshes make is allowed. */
static void test_ripple(void)
{
    int count = check_rounds((int)(sizeof ripples / sizeof ripples[0]));
    for (int i = 0; i < count; i++) {
        double normal, drag;
        slide_over(ripples[i].type, ripples[i].cell, ripples[i].radius, &normal, &drag);
        CHECK(normal < 1.25 * ripples[i].normal);
        CHECK(drag < 1.25 * ripples[i].drag);
    }
}

/* ---- tangent --------------------------------------------------------------------------------------------------- */

/* Contact as it is, with a look at its blocks when a step is done. */
typedef struct probe {
    sbi_touch real;
    const sb_contact *contact;
    double worst, size; /* N: blocks against differences, and the largest of these */
    int looks;
} probe;
static probe probing;

/* Forces at du + share * way, with friction's bounds as they are; to be freed. */
static sb_vec3 *forces_at(void *user, const sb_vec3 *du, double share, const sb_vec3 *way)
{
    const sbi_touch *touch = &probing.contact->touch;
    size_t count = (size_t)touch->node_count;
    sb_vec3 *at = (sb_vec3 *)malloc((count + 1) * sizeof *at), *force = (sb_vec3 *)malloc((count + 1) * sizeof *force);
    for (size_t k = 0; k < count; k++)
        at[k] = sb_v3_madd(du[k], REAL(share), way[k]);
    touch->evaluate(user, at, 0);
    memcpy(force, touch->force, count * sizeof *force);
    free(at);
    return force;
}

/* K times a random way, against forces a little way on and back. */
static void look(void *user, const sb_vec3 *du)
{
    const sbi_touch *touch = &probing.contact->touch;
    size_t count = (size_t)touch->node_count;
    const double step = 1e-9; /* m */
    unsigned long long seed = 3;
    sb_vec3 *way = (sb_vec3 *)malloc((count + 1) * sizeof *way),
            *product = (sb_vec3 *)malloc((count + 1) * sizeof *way);
    sb_vec3 *ahead, *behind;
    for (size_t k = 0; k < count; k++) {
        double x = check_random_in(&seed, -1, 1), y = check_random_in(&seed, -1, 1);
        way[k] = sb_v3(REAL(x), REAL(y), REAL(check_random_in(&seed, -1, 1)));
    }
    ahead = forces_at(user, du, step, way);
    behind = forces_at(user, du, -step, way);
    touch->evaluate(user, du, 0);
    touch->multiply(user, NULL, way, product);
    for (size_t k = 0; k < count; k++) {
        sb_vec3 slope = sb_v3_scale(REAL(0.5 / step), sb_v3_sub(behind[k], ahead[k]));
        probing.worst = fmax(probing.worst, (double)sb_v3_norm(sb_v3_sub(slope, product[k])));
        probing.size = fmax(probing.size, (double)sb_v3_norm(product[k]));
    }
    probing.looks += touch->touching > 0;
    free(way);
    free(product);
    free(ahead);
    free(behind);
}

static void probe_evaluate(void *user, const sb_vec3 *du, int renew) { probing.real.evaluate(user, du, renew); }

/* The step's own end: where it stands is looked at, and evaluated again as it was. */
static int probe_accept(void *user, const sb_vec3 *u)
{
    const sbi_touch *touch = &probing.contact->touch;
    size_t count = (size_t)touch->node_count;
    const sb_vec3 *x = sb_body_positions(probing.contact->body), *rest = sb_body_rest_positions(probing.contact->body);
    sb_vec3 *du = (sb_vec3 *)malloc((count + 1) * sizeof *du);
    for (size_t k = 0; k < count; k++) {
        int node = touch->nodes[k];
        du[k] = sb_v3_sub(sb_v3_add(rest[node], u[node]), x[node]);
    }
    touch->evaluate(user, du, 1);
    look(user, du);
    touch->evaluate(user, du, 1);
    free(du);
    return probing.real.accept(user, u);
}

/* A tool with flat sides, of which the blocks are the whole derivative: sticking, slipping, without friction. */
static void check_tangent(sb_element_type type, const sb_tool_def *def, sb_vec3 way)
{
    sb_body_def body = sb_default_body_def();
    sb_tool_def tool_def = *def;
    press p;
    int tool;
    memset(&probing, 0, sizeof probing);
    body.material = sb_material_corotated(REAL(5e3), REAL(0.4), 1000);
    body.damping_stiffness = REAL(0.01);
    p = press_make(scene_box(type, 4, 4, 2, sb_v3(REAL(0.04), REAL(0.04), REAL(0.02)), 0), body, press_exact());
    scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    tool = press_add(&p, &tool_def);
    probing.real = p.contact->touch;
    probing.contact = p.contact;
    p.contact->touch.evaluate = probe_evaluate;
    p.contact->touch.accept = probe_accept;
    for (int i = 1; i <= 10; i++) {
        press_move(&p, tool, sb_v3_madd(tool_def.pose.position, REAL(i) / 10, way), tool_def.pose.rotation);
        CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
    }
    CHECK(probing.looks > 5 && probing.size > 0);
    CHECK(probing.worst <= scene_tolerance(1e-6, 1e9) * probing.size);
    press_free(&p);
}

static void test_tangent(void)
{
    sb_vec3 down = sb_v3(0, 0, REAL(-0.001)), aside = sb_v3(REAL(0.004), REAL(0.001), REAL(-0.001));
    const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20};
    if (sizeof(sb_real) < sizeof(double)) {
        CHECK_SKIP("differences of forces need double");
        return;
    }
    for (int i = 0; i < 4; i++) {
        sb_tool_def plane = press_plane(0.3, sb_v3(0, 0, REAL(0.02005)), 1);
        check_tangent(types[i], &plane, aside);
        plane.friction = 5;
        check_tangent(types[i], &plane, aside);
        plane.friction = 0;
        check_tangent(types[i], &plane, down);
    }
}

/* ---- energy ---------------------------------------------------------------------------------------------------- */

/* A cube without supports thrown at a tool that does not move, for a second: what is in it never exceeds what it was
 * thrown with. Returns the largest share. test_contact_hostile has cubes that fall and come to rest. */
static double thrown(const sb_tool_def *def, sb_integrator integrator)
{
    sb_body_def body = sb_default_body_def();
    sb_vec3 *velocities;
    sb_energy energy;
    double start, most = 0;
    press p;
    body.material = sb_material_corotated(REAL(2e4), REAL(0.4), 1000);
    body.integrator = integrator;
    body.spectral_radius = REAL(0.5);
    body.damping_stiffness = REAL(0.003);
    body.tolerance = REAL(1e-6);
    p = press_make(scene_box(SB_TET4, 4, 4, 4, sb_v3(REAL(0.03), REAL(0.03), REAL(0.03)), 0.1), body, press_exact());
    press_add(&p, def);
    velocities = (sb_vec3 *)calloc((size_t)p.mesh.node_count, sizeof *velocities);
    for (int i = 0; i < p.mesh.node_count; i++)
        velocities[i] = sb_v3(REAL(0.1), 0, REAL(-0.5));
    CHECK_OK(sb_body_set_velocities(p.body, velocities));
    CHECK_OK(sb_body_energy(p.body, &energy));
    start = (double)energy.kinetic;
    for (int i = 0; i < 200; i++) {
        CHECK_OK(sb_body_step(p.body, REAL(0.005), NULL));
        CHECK_OK(sb_body_energy(p.body, &energy));
        most = fmax(most, (double)energy.kinetic + (double)energy.elastic);
    }
    CHECK((double)energy.kinetic < 0.9 * start); /* it has hit */
    free(velocities);
    press_free(&p);
    return most / start;
}

static void test_thrown(void)
{
    sb_tool_def sphere = press_sphere(0.015, 0.4, sb_v3(REAL(0.02), REAL(0.015), REAL(-0.02)));
    sb_tool_def box =
        press_box(sb_v3(REAL(0.02), REAL(0.02), REAL(0.01)), 0.004, 0.4, sb_v3(REAL(0.03), REAL(0.015), REAL(-0.03)));
    box.pose.rotation = sb_quat_from_rotation_vector(sb_v3(REAL(0.3), REAL(0.4), 0));
    CHECK(thrown(&sphere, SB_EULER) <= 1 + scene_tolerance(1e-6, 1e3));
    CHECK(thrown(&box, SB_EULER) <= 1 + scene_tolerance(1e-6, 1e3));
    CHECK(thrown(&sphere, SB_GENERALISED_ALPHA) <= 1 + scene_tolerance(1e-6, 1e3));
    CHECK(thrown(&box, SB_GENERALISED_ALPHA) <= 1 + scene_tolerance(1e-6, 1e3));
}

/* ---- smoothness ------------------------------------------------------------------------------------------------ */

/* A sphere that goes down and aside by steps of a micrometre, over edges of faces: no step changes what it feels by
 * more than a thousandth. */
static void check_smooth(sb_element_type type, int cells, double friction)
{
    sb_body_def def = sb_default_body_def();
    sb_tool_def sphere = press_sphere(0.01, friction, sb_v3(REAL(0.0293), REAL(0.0311), REAL(0.0305)));
    sb_wrench last = {{0, 0, 0}, {0, 0, 0}};
    double worst = 0, aside = 0, deep = 0;
    press p;
    int tool;
    def.material = sb_material_corotated(REAL(5e3), REAL(0.45), 1000);
    def.damping_stiffness = REAL(0.01);
    p = press_make(scene_box(type, cells, cells, cells / 2, sb_v3(REAL(0.06), REAL(0.06), REAL(0.02)), 0.1), def,
                   press_exact());
    scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    tool = press_add(&p, &sphere);
    for (int i = -60; i < (check_quick() ? 150 : 400); i++) {
        sb_wrench wrench;
        deep += i < -30 ? 1e-4 : i < 0 ? 0 : 4e-7;
        aside += i < 0 ? 0 : 9e-7;
        press_move(&p, tool, sb_v3(REAL(0.0293 + 0.8 * aside), REAL(0.0311 + 0.6 * aside), REAL(0.0305 - deep)),
                   sb_quat_identity());
        CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
        wrench = press_wrench(&p, tool);
        if (i > 0)
            worst = fmax(worst, (double)(sb_v3_norm(sb_v3_sub(wrench.force, last.force)) / sb_v3_norm(last.force)));
        last = wrench;
    }
    CHECK(last.force.z > REAL(0.1));
    printf("    %s, mu %g: largest change in a step %.2e\n", sb_element_name(type), friction, worst);
    CHECK(worst < 1e-3);
    press_free(&p);
}

static void test_smooth(void)
{
    check_smooth(SB_TET4, 8, 0);
    check_smooth(SB_HEX8, 6, 0.3);
    check_smooth(SB_TET10, 4, 0.3);
}

CHECK_SUITE(contact_series, {"Hertz", test_hertz}, {"slope", test_slope}, {"ripple", test_ripple},
            {"tangent", test_tangent}, {"thrown", test_thrown}, {"smooth", test_smooth});
