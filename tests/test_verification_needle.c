/* Needles in tissue against closed forms: friction and cutting, lateral and axial stiffness over the mesh's edges,
 * curvature of both bevel laws, spinning bevels, the way that was cut, membranes over the time step, needles side by
 * side, entries into curved skin and beside edges, mixtures, feeds of any speed, tiny steps, a rod near its buckling
 * load. Held by springs (NDL_EMBED). */
#include "needle_stiffness.h"
#include "verification.h"

static const double dt = 0.02, speed = 0.01;

static needle_scene make_scene(sb_element_type type, int cells)
{
    needle_scene s = needle_scene_default();
    s.type = type;
    s.cells[0] = s.cells[1] = s.cells[2] = cells;
    s.needle_def.follow = NDL_EMBED;
    s.body_def.slack = 0;
    return s;
}

static const char *describe(const char *element, double edge, const char *what)
{
    static char text[80];
    snprintf(text, sizeof text, "%s, edges of %.3g mm, %s", element, 1e3 * edge, what);
    return text;
}

static double law(const needle_scene *s, int needle)
{
    return (double)s->frictions[0].cutting +
           (double)s->frictions[0].friction * (double)ndl_needle_depth(s->needles[needle]);
}

/* ---- along the shaft ---- */

static void verify_push(sb_element_type type, const char *element)
{
    needle_scene s = make_scene(type, type == SB_TET4 ? 4 : 3);
    double most = 0;
    if (!needle_scene_make(&s))
        return;
    for (int i = 0; i < 60 && needle_scene_run(&s, 2 * dt, 1, needle_command(speed, 0)); i++)
        most = verify_worse(most, needle_push(&s) / law(&s, 0) - 1);
    verify("needle 23 mm deep, fed", element, "cutting + friction x depth", "force on the hand (N)", law(&s, 0),
           needle_push(&s), 0.02);
    verify("the same, from the skin on", element, "cutting + friction x depth", "most beyond that / it, in any step", 0,
           most, 0.05);
    needle_scene_free(&s);
}

static void test_push(void)
{
    verify_push(SB_TET4, "tet4");
    verify_push(SB_TET10, "tet10");
    verify_push(SB_HEX8, "hex8");
}

/* Sixteen needles, or four, 5 mm apart. */
static void verify_template(int cells, int wide)
{
    needle_scene s = make_scene(SB_TET4, cells);
    double off = 0;
    s.needle_def.base.x = REAL(0.0113), s.needle_def.base.y = REAL(0.0121);
    if (!needle_scene_make_body(&s))
        return;
    for (int n = 0; n < wide * wide; n++)
        needle_scene_add(&s, sb_v3(REAL(0.005 * (n % wide)), REAL(0.005 * (n / wide)), 0));
    needle_scene_run(&s, dt, 50, needle_command(2 * speed, 0));
    for (int n = 0; n < s.count; n++) {
        sb_vec3 force;
        ndl_needle_base_wrench(s.needles[n], &force, NULL);
        off = verify_worse(off, fabs(-(double)force.z / law(&s, n) - 1));
    }
    verify(wide == 4 ? "16 needles 5 mm apart, fed together" : "4 needles 5 mm apart, fed together",
           describe("tet4", 0.04 / cells, "50 kPa"), "cutting + friction x depth",
           "largest error of a needle's force / it", 0, off, 0.06);
    needle_scene_free(&s);
}

static void test_template(void)
{
    verify_template(4, 2);
    verify_template(4, 4);
}

/* ---- across the shaft ---- */

/* Force over way of a base that is pushed aside, the needle 45 mm deep (N/m). */
static double stiffness(int cells, ndl_rod_preset preset, double young)
{
    needle_scene s = make_scene(SB_TET4, cells);
    needle_make_deep(&s, preset, young);
    return needle_side_stiffness(&s, 10);
}

static void test_stiffness(void)
{
    static const struct {
        ndl_rod_preset preset;
        double young, reference;
        const char *name;
    } cases[] = {{NDL_NITINOL_083, 60e3, 497, "nitinol 0.83 mm, 45 mm deep in 60 kPa, pushed aside"},
                 {NDL_STYLET_18G, 12e3, 449, "steel 1.27 mm, 45 mm deep in 12 kPa, pushed aside"}};
    for (int k = 0; k < 2; k++)
        for (int cells = 4; cells <= 8; cells += 4)
            verify(cases[k].name, describe("tet4", 0.07 / cells, "corotated"), "needle as a solid of hex20, graded",
                   "stiffness of the base (N/m)", cases[k].reference, stiffness(cells, cases[k].preset, cases[k].young),
                   0.08);
}

/* ---- ways ---- */

/* In a wide block, its director across. */
static needle_scene make_wide(double edge, double young)
{
    needle_scene s = make_scene(SB_TET4, 1);
    s.size = sb_v3(REAL(0.09), REAL(0.09), REAL(0.11));
    for (int k = 0; k < 3; k++)
        s.cells[k] = (int)((k < 2 ? 0.09 : 0.11) / edge + 0.5);
    s.materials[0].young = REAL(young), s.materials[0].poisson = REAL(0.45);
    s.frictions[0].friction = 5, s.frictions[0].cutting = REAL(0.1);
    ndl_rod_section_preset(NDL_NITINOL_083, &s.needle_def.section);
    s.needle_def.base = sb_v3(REAL(0.0457), REAL(0.0443), REAL(0.122));
    s.needle_def.length = REAL(0.011);
    return s;
}

enum { WAY_STEPS = 100 };

/* The tip's places from the skin on, a millimetre of feeding between them. */
typedef struct way {
    sb_vec3 places[WAY_STEPS + 1];
    int count;
} way;

/* Fed by 1 mm a step to `depth` (m), turned by `twist` (rad/m); the body lives. */
static int follow(needle_scene *s, double depth, double twist, way *w)
{
    const ndl_command command = needle_command(0.001 / dt, 0.001 / dt * twist);
    w->count = 1;
    w->places[0] = sb_v3(s->needle_def.base.x, s->needle_def.base.y, s->size.z);
    if (!needle_scene_make(s))
        return 0;
    while (w->count <= WAY_STEPS && (double)ndl_needle_depth(s->needles[0]) < depth &&
           needle_scene_run(s, dt, 1, command))
        if (ndl_needle_depth(s->needles[0]) > 0)
            w->places[w->count++] = needle_tip(s->needles[0]);
    return CHECK(w->count > 10);
}

/* Of the circle through three places (1/m). */
static double curvature(const way *w)
{
    sb_vec3 p = w->places[w->count / 4], q = w->places[w->count / 2], r = w->places[w->count - 1];
    sb_vec3 a = sb_v3_sub(q, p), b = sb_v3_sub(r, q), c = sb_v3_sub(r, p);
    return 2 * (double)sb_v3_norm(sb_v3_cross(a, c)) /
           ((double)sb_v3_norm(a) * (double)sb_v3_norm(b) * (double)sb_v3_norm(c));
}

/* (4 EI / k)^(1/4), k that of Kelvin's line load between the bends' length and the needle's radius. */
static double bends(const needle_scene *s)
{
    const double young = (double)s->materials[0].young, nu = (double)s->materials[0].poisson;
    ndl_rod_stiffness rod = ndl_rod_stiffness_of(&s->needle_def.section);
    double length = 0.01;
    for (int i = 0; i < 20; i++) {
        double k = 8 * 3.14159265358979 * young / (2 * (1 + nu)) * (1 - nu) /
                   ((3 - 4 * nu) * log(length / (double)s->needle_def.section.radius));
        length = pow(4 * (double)rod.bending[0] / k, 0.25);
    }
    return length;
}

static void verify_bevel(double edge, double young, ndl_bevel_law which)
{
    needle_scene s = make_wide(edge, young);
    ndl_bevel *bevel = &s.needle_def.bevel;
    const int soft = young < 1e6;
    sb_real expected = 0;
    way w;
    bevel->law = which;
    bevel->curvature = soft ? 12 : 6;
    bevel->angle = bevel->lag = REAL(0.05);
    if (!soft)
        bevel->angle = REAL(0.02);
    CHECK_OK(ndl_bevel_curvature(bevel, 0, bevel->guide, &expected));
    if (follow(&s, 0.08, 0, &w))
        verify(soft ? "bevelled nitinol, lag 0.05, in gel that gives way"
                    : "bevelled nitinol in gel that does not give way",
               describe("tet4", edge, soft ? "50 kPa" : "1 GPa"),
               soft                       ? "lag / (4 EI / k)^(1/4), k: Kelvin's line load"
               : which == NDL_BEVEL_ANGLE ? "the law of the angle"
                                          : "the law of the curvature",
               "curvature of the way (1/m)", soft ? 0.05 / bends(&s) : (double)expected, curvature(&w),
               soft ? 0.08 : 0.01);
    needle_scene_free(&s);
}

static void test_bevel(void)
{
    verify_bevel(0.015, 1e9, NDL_BEVEL_CURVATURE);
    verify_bevel(0.015, 1e9, NDL_BEVEL_ANGLE);
    verify_bevel(0.018, 5e4, NDL_BEVEL_ANGLE);
    verify_bevel(0.0125, 5e4, NDL_BEVEL_CURVATURE);
}

/* Distance of a point from what is cut (m). */
static double off_way(const way *w, sb_vec3 x)
{
    double least = 1;
    for (int i = 0; i + 1 < w->count; i++) {
        sb_vec3 edge = sb_v3_sub(w->places[i + 1], w->places[i]), to = sb_v3_sub(x, w->places[i]);
        double share = (double)sb_v3_dot(to, edge) / (double)sb_v3_dot(edge, edge);
        share = fmin(fmax(share, 0), 1);
        least = fmin(least, (double)sb_v3_norm(sb_v3_sub(to, sb_v3_scale(REAL(share), edge))));
    }
    return least;
}

static double shaft_off_way(const needle_scene *s, const way *w)
{
    const ndl_rod *rod = ndl_needle_rod(s->needles[0]);
    double most = 0;
    for (int i = ndl_needle_entry(s->needles[0]); i < ndl_rod_node_count(rod); i++)
        most = verify_worse(most, off_way(w, ndl_rod_positions(rod)[i]));
    return most;
}

static void test_way(void)
{
    needle_scene s = make_wide(0.015, 1e9);
    const char *element = "tet4, edges of 15 mm, 1 GPa", *source = "the way that the tip cut";
    way w;
    s.needle_def.bevel.curvature = 8;
    s.needle_def.director = sb_v3(-1, 0, 0);
    if (follow(&s, 0.08, 0, &w)) {
        verify("bevelled nitinol, 80 mm deep", element, source, "shaft off its way / 80 mm", 0,
               shaft_off_way(&s, &w) / 0.08, 6e-4);
        needle_scene_run(&s, dt, 60, needle_command(-0.0005 / dt, 0));
        verify("the same, drawn back by 30 mm", element, source, "shaft off its way / 80 mm", 0,
               shaft_off_way(&s, &w) / 0.08, 6e-4);
    }
    needle_scene_free(&s);
}

static void test_spin(void)
{
    static const double twists[2] = {150, 900};
    for (int k = 0; k < 2; k++) {
        needle_scene s = make_wide(0.015, 1e9);
        way w;
        s.needle_def.bevel.curvature = 8;
        if (follow(&s, 0.09, twists[k], &w)) {
            ndl_tip_pose start, end;
            start.position = w.places[0];
            start.frame.t = sb_v3(0, 0, -1);
            start.frame.m1 = s.needle_def.director;
            start.frame.m2 = sb_v3_cross(start.frame.t, start.frame.m1);
            start = ndl_tip_turn(&start, REAL(twists[k] * 0.001)); /* on its way to the skin */
            end = ndl_helix_pose(&start, 8, REAL(twists[k]), ndl_needle_depth(s.needles[0]));
            verify(k ? "bevelled nitinol (8/m), turned by 900 rad/m, 90 mm deep"
                     : "bevelled nitinol (8/m), turned by 150 rad/m, 90 mm deep",
                   "tet4, edges of 15 mm, 1 GPa", "helix of curvature and twist", "tip off it / 90 mm", 0,
                   (double)sb_v3_norm(sb_v3_sub(needle_tip(s.needles[0]), end.position)) / 0.09, 3e-3);
        }
        needle_scene_free(&s);
    }
}

/* ---- membranes ---- */

/* What the hand feels at most beside friction, about a membrane within (N), 50 mm/s. */
static double find_peak(double step)
{
    static const ndl_membrane membrane = {{0, 1}, REAL(1.5), REAL(0.0005)};
    needle_scene s = make_scene(SB_TET4, 4);
    double peak = 0;
    sb_vec3 X = sb_v3(0, 0, 1);
    s.layered = 1;
    s.needle_def.membranes = &membrane;
    s.needle_def.membrane_count = 1;
    if (needle_scene_make(&s))
        while (X.z > REAL(0.012) && needle_scene_run(&s, step, 1, needle_command(0.05, 0))) {
            peak = fmax(peak, (double)s.info.peak_base - 20 * (double)ndl_needle_depth(s.needles[0]));
            (void)ndl_needle_tip_material(s.needles[0], &X);
        }
    needle_scene_free(&s);
    return peak;
}

static void test_membranes(void)
{
    static const double steps[3] = {0.05, 0.02, 0.005};
    for (int k = 0; k < 3; k++) {
        char name[80];
        snprintf(name, sizeof name, "membrane of 0.5 mm and 1.5 N at 50 mm/s, dt %g ms", 1e3 * steps[k]);
        verify(name, "tet4, edges of 10 mm, 50 kPa", "cutting + strength", "peak of the hand's force (N)", 2,
               find_peak(steps[k]), 0.06);
    }
}

/* ---- entries ---- */

static const double pi = 3.14159265358979;

/* A needle whose tip is 1 mm before the skin at `at`, at `tilt` (rad) from its outer normal; NULL: it would begin in
 * the tissue. */
static ndl_needle *aim_at(sb_body *body, const ndl_friction *friction, sb_vec3 at, sb_vec3 normal, double tilt,
                          unsigned long long *seed)
{
    ndl_needle_def def = ndl_default_needle_def();
    ndl_needle *needle = NULL;
    double turn = check_random_in(seed, 0, 2 * pi);
    sb_vec3 side = sb_v3_cross(normal, sb_abs(normal.x) < REAL(0.7) ? sb_v3(1, 0, 0) : sb_v3(0, 1, 0)), other;
    side = sb_v3_scale(1 / sb_v3_norm(side), side);
    other = sb_v3_cross(normal, side);
    side = sb_v3_add(sb_v3_scale(REAL(cos(turn)), side), sb_v3_scale(REAL(sin(turn)), other));
    def.body = body;
    def.follow = NDL_EMBED;
    def.frictions = friction;
    def.friction_count = 1;
    def.direction = sb_v3_madd(sb_v3_scale(REAL(-cos(tilt)), normal), REAL(sin(tilt)), side);
    def.length = REAL(0.012);
    def.base = sb_v3_madd(at, REAL(-0.013), def.direction);
    ndl_rod_section_preset(check_random(seed) < 0.5 ? NDL_STYLET_18G : NDL_NITINOL_083, &def.section);
    return ndl_needle_create(&def, &needle, NULL) == SB_OK ? needle : NULL;
}

/* Most force on the hand over three times the law and 0.2 N, in any of 15 steps of 0.4 mm. */
static double enter(sb_body *body, ndl_needle *needle, const ndl_friction *f)
{
    const ndl_command command = needle_command(2 * speed, 0);
    double most = 0;
    for (int i = 0; i < 15; i++) {
        sb_vec3 force;
        double right;
        if (!CHECK_OK(ndl_step(body, &needle, 1, REAL(dt), &command, NULL, NULL)))
            break;
        ndl_needle_base_wrench(needle, &force, NULL);
        right = (double)f->cutting + (double)f->friction * (double)ndl_needle_depth(needle);
        most = verify_worse(most, (double)sb_v3_norm(force) / (3 * right + 0.2));
    }
    return most;
}

/* So many random entries of one organ, which is at rest before each; most of them all. place: a place of the skin, its
 * normal, and an angle from that. */
static double enter_often(const sb_mesh *mesh, int wanted,
                          double (*place)(unsigned long long *seed, sb_vec3 *at, sb_vec3 *normal))
{
    static const ndl_friction friction = {20, 0, REAL(0.3), 0, 0};
    sb_body_def def = needle_scene_body_def();
    unsigned long long seed = 31;
    sb_body *body = NULL;
    double most = 0;
    int entries = 0;
    def.slack = 0;
    def.material = sb_material_corotated(15000, REAL(0.45), 1000);
    def.mesh = mesh;
    if (!CHECK_OK(sb_body_create(&def, &body, NULL)))
        return 0;
    for (int i = 0; i < mesh->node_count; i++)
        if (mesh->nodes[i].z < REAL(-0.019))
            CHECK_OK(sb_body_hold(body, &i, 1, SB_XYZ, NULL));
    for (int i = 0; i < 3 * wanted && entries < wanted; i++) {
        sb_vec3 at, normal;
        double tilt = place(&seed, &at, &normal);
        ndl_needle *needle = aim_at(body, &friction, at, normal, tilt, &seed);
        if (!needle)
            continue;
        most = verify_worse(most, enter(body, needle, &friction));
        ndl_needle_destroy(needle);
        sb_body_reset(body);
        entries++;
    }
    CHECK_INT(entries, wanted);
    sb_body_destroy(body);
    return most;
}

static const sb_real radii[3] = {REAL(0.04), REAL(0.03), REAL(0.025)};

static sb_real ellipsoid_distance(void *user, sb_vec3 x)
{
    const double q[3] = {(double)(x.x / radii[0]), (double)(x.y / radii[1]), (double)(x.z / radii[2])};
    double square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2], slope = 0;
    (void)user;
    for (int c = 0; c < 3; c++)
        slope += q[c] * q[c] / ((double)radii[c] * (double)radii[c]);
    return slope > 0 ? REAL(sqrt(square) * (sqrt(square) - 1) / sqrt(slope)) : -radii[2];
}

/* Anywhere but below, at up to 70 degrees. */
static double place_on_ellipsoid(unsigned long long *seed, sb_vec3 *at, sb_vec3 *normal)
{
    double turn = check_random_in(seed, 0, 2 * pi), up = check_random_in(seed, -0.2, 1), flat = sqrt(1 - up * up);
    sb_vec3 n = sb_v3(REAL(flat * cos(turn)) / radii[0], REAL(flat * sin(turn)) / radii[1], REAL(up) / radii[2]);
    *at = sb_v3(n.x * radii[0] * radii[0], n.y * radii[1] * radii[1], n.z * radii[2] * radii[2]);
    *normal = sb_v3_scale(1 / sb_v3_norm(n), n);
    return check_random_in(seed, 0, 70 * pi / 180);
}

/* Of a block's side, 2 to 8 mm below its upper edge, at up to 86 degrees. */
static double place_below_edge(unsigned long long *seed, sb_vec3 *at, sb_vec3 *normal)
{
    double below = check_random_in(seed, 0.002, 0.008);
    *at = sb_v3(REAL(0.03), REAL(check_random_in(seed, -0.02, 0.02)), REAL(0.02 - below));
    *normal = sb_v3(1, 0, 0);
    return check_random_in(seed, 0, 86 * pi / 180);
}

static void test_curved(void)
{
    sb_stuff_def def = sb_default_stuff_def();
    sb_shape shape;
    sb_mesh mesh;
    memset(&shape, 0, sizeof shape);
    shape.distance = ellipsoid_distance;
    shape.max_slope = 1;
    def.shapes = &shape;
    def.shape_count = 1;
    def.low = sb_v3(REAL(-0.05), REAL(-0.05), REAL(-0.05));
    def.high = sb_v3(REAL(0.05), REAL(0.05), REAL(0.05));
    def.cell = REAL(0.012);
    if (!CHECK_OK(sb_mesh_stuff(&def, &mesh, NULL, NULL)))
        return;
    verify("500 entries into curved skin, at up to 70 degrees", "tet4, cells of 12 mm, 15 kPa",
           "cutting + friction x depth", "most force / (3 x that + 0.2 N), in any step", 0,
           enter_often(&mesh, 500, place_on_ellipsoid), 1);
    sb_mesh_free(&mesh);
}

static void test_edges(void)
{
    const sb_vec3 size = {REAL(0.06), REAL(0.05), REAL(0.04)};
    sb_mesh mesh;
    if (!CHECK_OK(sb_mesh_beam(SB_TET4, 5, 4, 3, size, NULL, &mesh, NULL)))
        return;
    for (int i = 0; i < mesh.node_count; i++)
        mesh.nodes[i] = sb_v3_madd(mesh.nodes[i], REAL(-0.5), size);
    verify("100 entries 2 to 8 mm below an edge, at up to 86 degrees", "tet4, edges of 12 mm, 15 kPa",
           "cutting + friction x depth", "most force / (3 x that + 0.2 N), in any step", 0,
           enter_often(&mesh, 100, place_below_edge), 1);
    sb_mesh_free(&mesh);
}

/* ---- mixtures, speeds, tiny steps ---- */

static sb_real below_distance(void *user, sb_vec3 x)
{
    (void)user;
    return x.z - REAL(0.0253);
}

/* Two tissues whose border runs through elements, each of its own friction: no element is of one alone there. */
static void test_mixture(void)
{
    needle_scene s = make_scene(SB_TET4, 4);
    sb_mixture_def def = sb_default_mixture_def();
    sb_shape shape;
    sb_mixture mixture;
    double right, upper = 0.04 - 0.0253;
    memset(&shape, 0, sizeof shape);
    shape.distance = below_distance;
    shape.max_slope = 1;
    shape.region = 1;
    s.shake = 0;
    s.mesh = scene_box(s.type, 4, 4, 4, s.size, 0);
    def.mesh = &s.mesh;
    def.shapes = &shape;
    def.shape_count = 1;
    if (!CHECK_OK(sb_mixture_create(&def, &mixture, NULL)))
        return;
    s.body_def.mesh = &mixture.body_mesh;
    s.body_def.domain = &mixture.domain;
    s.body_def.material = needle_scene_material_of(&s, 0);
    s.frictions[1].friction = 60;
    s.needle_def.frictions = s.frictions;
    s.needle_def.friction_count = 2;
    if (CHECK_OK(sb_body_create(&s.body_def, &s.body, &s.error))) {
        for (int i = 0; i < s.mesh.node_count; i++)
            if (needle_scene_is_side(&s, s.mesh.nodes[i]))
                CHECK_OK(sb_body_hold(s.body, &i, 1, SB_XYZ, NULL));
        if (needle_scene_add(&s, sb_v3(0, 0, 0)) && needle_scene_run(&s, 2 * dt, 85, needle_command(speed, 0))) {
            right = (double)s.frictions[0].cutting + 20 * upper + 60 * ((double)ndl_needle_depth(s.needles[0]) - upper);
            verify("needle 33 mm deep, in two tissues whose border runs through elements", "tet4, mixed by volume",
                   "cutting + friction x depth, of each", "force on the hand (N)", right, needle_push(&s), 0.05);
        }
    }
    needle_scene_free(&s);
    sb_mixture_free(&mixture);
}

static void test_speed(void)
{
    static const double speeds[3] = {0.005, 0.02, 0.1};
    for (int k = 0; k < 3; k++) {
        needle_scene s = make_scene(SB_TET4, 4);
        char name[80];
        snprintf(name, sizeof name, "needle 23 mm deep, fed at %g mm/s", 1e3 * speeds[k]);
        s.frictions[0].viscous = 100;
        if (needle_scene_make(&s) && needle_scene_run(&s, 0.0004 / speeds[k], 60, needle_command(speeds[k], 0)))
            verify(name, "tet4", "cutting + (friction + viscosity x speed) x depth", "force on the hand (N)",
                   law(&s, 0) + 100 * speeds[k] * (double)ndl_needle_depth(s.needles[0]), needle_push(&s), 0.03);
        needle_scene_free(&s);
    }
}

/* The force after 60 steps of 10 mm/s, four of 1e-12 s among them or none. */
static double push_past(int tiny_steps)
{
    needle_scene s = make_scene(SB_TET4, 4);
    double push = 0;
    if (needle_scene_make(&s)) {
        for (int i = 0; i < 60; i++) {
            if (tiny_steps && i % 15 == 7)
                needle_scene_run(&s, SB_REAL_IS_FLOAT ? 1e-5 : 1e-12, 1, needle_command(speed, 0));
            needle_scene_run(&s, dt, 1, needle_command(speed, 0));
        }
        push = needle_push(&s);
    }
    needle_scene_free(&s);
    return push;
}

static void test_tiny_steps(void)
{
    verify("needle 11 mm deep, four steps of 1e-12 s among those of 20 ms", "tet4", "the same without them",
           "force on the hand (N)", push_past(0), push_past(1), 1e-3);
}

/* ---- a rod that is pressed ---- */

/* A clamped stylet of 20 cm, its tip pressed by `share` of Euler's load and pushed aside a little: deflection over that
 * push (m/N). */
static double pressed(double share)
{
    enum { EDGES = 40 };
    const double length = 0.2, edge = length / (double)EDGES, aside = 1e-5;
    ndl_rod_def def = ndl_default_rod_def();
    ndl_rod *rod = NULL;
    sb_vec3 nodes[EDGES + 2];
    double load, result = 0;
    for (int i = 0; i < EDGES + 2; i++)
        nodes[i] = sb_v3(0, 0, REAL(edge * i));
    def.nodes = nodes;
    def.node_count = EDGES + 2;
    load = share * pi * pi * (double)ndl_rod_stiffness_of(&def.section).bending[0] / (4 * length * length);
    if (!CHECK_OK(ndl_rod_create(&def, &rod, NULL)))
        return 0;
    CHECK_OK(ndl_rod_hold(rod, 0, nodes[0], NULL));
    CHECK_OK(ndl_rod_hold(rod, 1, nodes[1], NULL));
    CHECK_OK(ndl_rod_set_force(rod, EDGES + 1, sb_v3(REAL(aside), 0, REAL(-load))));
    if (CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL)))
        result = (double)ndl_rod_positions(rod)[EDGES + 1].x / aside;
    ndl_rod_destroy(rod);
    return result;
}

static void test_pressed(void)
{
    const double length = 0.2, share = 0.9;
    ndl_rod_def def = ndl_default_rod_def();
    double bending = (double)ndl_rod_stiffness_of(&def.section).bending[0], k = 0.5 * pi * sqrt(share) / length;
    verify("clamped rod pressed by 0.9 of its buckling load", "40 edges", "beam-column: (tan kL - kL) / (k^3 EI)",
           "deflection / force aside (m/N)", (tan(k * length) - k * length) / (k * k * k * bending), pressed(share),
           0.02);
}

static void test_table(void) { verify_table("verification_needle"); }

CHECK_SUITE(verification_needle, {"push", test_push}, {"template", test_template}, {"stiffness", test_stiffness},
            {"bevel", test_bevel}, {"way", test_way}, {"spin", test_spin}, {"membranes", test_membranes},
            {"curved skin", test_curved}, {"edges", test_edges}, {"mixture", test_mixture}, {"speed", test_speed},
            {"tiny steps", test_tiny_steps}, {"pressed", test_pressed}, {"table", test_table});
