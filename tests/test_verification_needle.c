/* Needles in tissue against closed forms: friction and cutting, lateral and axial stiffness over the mesh's edges,
 * curvature of both bevel laws, spinning bevels, the way that was cut, membranes over the time step, needles side by
 * side, mixtures. Held by springs (NDL_EMBED). */
#include "needle_scene.h"
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
    const double way = 0.0005;
    double result = 0;
    ndl_command aside = needle_command(0, 0);
    s.size = sb_v3(REAL(0.07), REAL(0.07), REAL(0.07));
    s.materials[0].young = REAL(young), s.materials[0].poisson = REAL(0.45);
    s.frictions[0].friction = s.frictions[0].cutting = 0;
    ndl_rod_section_preset(preset, &s.needle_def.section);
    s.needle_def.base = sb_v3(REAL(0.0353), REAL(0.0341), REAL(0.082));
    s.needle_def.length = REAL(0.011);
    s.body_def.max_iterations = 2000;
    aside.velocity.x = REAL(way / 0.2);
    if (needle_scene_make(&s) && needle_scene_run(&s, 0.05, 46, needle_command(0.02, 0))) {
        sb_vec3 before, after;
        ndl_needle_base_wrench(s.needles[0], &before, NULL);
        needle_scene_run(&s, 0.05, 4, aside);
        needle_scene_run(&s, 0.05, 10, needle_command(0, 0));
        ndl_needle_base_wrench(s.needles[0], &after, NULL);
        result = (double)(after.x - before.x) / way;
    }
    needle_scene_free(&s);
    return result;
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

static void test_table(void) { verify_table("verification_needle"); }

CHECK_SUITE(verification_needle, {"push", test_push}, {"template", test_template}, {"stiffness", test_stiffness},
            {"bevel", test_bevel}, {"way", test_way}, {"spin", test_spin}, {"membranes", test_membranes},
            {"table", test_table});
