/* Thin sheets on faces: strips, squares and balloons against the closed forms of incompressible neo-Hookean sheets;
 * cavities: volumes, and spheres that are filled. What sheets lie on is a ten-millionth as stiff. */
#include "verification_scene.h"

static const double shear = 1e4, thickness = 0.001;
static const char *const names[] = {"tet4", "tet10", "hex8", "hex20", "hex27"};

/* ---- a square sheet ---- */

/* A slab of 1 x 1 x 0.1 m, uneven, with a sheet on z = 0. */
typedef struct square {
    sb_mesh mesh;
    sb_body *body;
    int sheet;
} square;

/* Cells that grow along x and shear along y; the sides stay straight. */
static sb_vec3 map_slab(const void *user, double x, double y, double z)
{
    (void)user;
    return sb_v3(REAL(x + 0.4 * x * (1 - x) + 0.15 * x * (1 - x) * sin(5 * y)),
                 REAL(y + 0.3 * y * (1 - y) * cos(4 * x + 1)), REAL(0.1 * z));
}

static int square_make(square *s, const char *name, int wrinkles)
{
    const verify_plane below = {2, 0};
    sb_membrane_def sheet = sb_default_membrane_def();
    int *faces, ok;
    memset(s, 0, sizeof *s);
    s->mesh = verify_block(verify_element_named(name)->type, 4, 4, 1, map_slab, NULL, 1);
    s->body = verify_body(&s->mesh, verify_element_named(name), sb_material_neo_hookean(REAL(1e-7 * shear), 0, 1000));
    sheet.corners = verify_face_corners(&s->mesh);
    sheet.face_count = verify_faces(&s->mesh, verify_on_plane, &below, sheet.corners, &faces);
    sheet.faces = faces;
    sheet.thickness = REAL(thickness), sheet.shear = REAL(shear), sheet.wrinkles = wrinkles;
    ok = CHECK_OK(sb_body_add_membrane(s->body, &sheet, &s->sheet, NULL));
    free(faces);
    scene_fix_plane(s->body, &s->mesh, 2, 0, SB_Z);
    return ok;
}

/* Pulled to 1.3 of its length the sheet narrows to 1.3^-1/2, taut or in wrinkles: mu H (a - a^-2) for each metre. */
static void test_strip(void)
{
    const double a = 1.3;
    const verify_plane start = {0, 0}, side = {1, 0}, end = {0, 1};
    for (int k = 0; k < 5; k++)
        for (int wrinkles = 0; wrinkles < 2; wrinkles++) {
            square s;
            if (!square_make(&s, names[k], wrinkles))
                return;
            verify_move(s.body, &s.mesh, verify_on_plane, &start, SB_X, sb_v3(0, 0, 0));
            verify_move(s.body, &s.mesh, verify_on_plane, &side, SB_Y, sb_v3(0, 0, 0));
            verify_move(s.body, &s.mesh, verify_on_plane, &end, SB_X, sb_v3(REAL(a - 1), 0, 0));
            verify_solve(s.body);
            verify(wrinkles ? "sheet that wrinkles pulled to 1.3, free to narrow, uneven"
                            : "sheet pulled to 1.3, free to narrow, uneven",
                   names[k], "mu H (a - a^-2)", "force over width (N/m)", shear * thickness * (a - 1 / (a * a)),
                   (double)verify_reaction(s.body, &s.mesh, verify_on_plane, &end).x, 1.2e-5);
            verify_free(s.body, &s.mesh);
        }
}

/* Pulled to 1.4 both ways: mu H (a - a^-5) for each metre. */
static void test_biaxial(void)
{
    const double a = 1.4;
    const verify_plane planes[4] = {{0, 0}, {1, 0}, {0, 1}, {1, 1}};
    for (int k = 0; k < 5; k++) {
        square s;
        if (!square_make(&s, names[k], 1))
            return;
        for (int p = 0; p < 4; p++)
            verify_move(s.body, &s.mesh, verify_on_plane, planes + p, p % 2 ? SB_Y : SB_X,
                        p < 2 ? sb_v3(0, 0, 0) : sb_v3(REAL(a - 1), REAL(a - 1), 0));
        verify_solve(s.body);
        verify("sheet pulled to 1.4 both ways, uneven", names[k], "mu H (a - a^-5)", "force over width (N/m)",
               shear * thickness * (a - pow(a, -5)),
               (double)verify_reaction(s.body, &s.mesh, verify_on_plane, planes + 2).x, 1e-5);
        verify_free(s.body, &s.mesh);
    }
}

/* Largest error of what a face should carry, tension and direction (in tensions), over mu H. */
static double diagonal_error(const square *s, double a)
{
    double worst = 0;
    int faces = 0;
    sb_membrane_state *states;
    CHECK_OK(sb_body_membrane_faces(s->body, s->sheet, &faces, NULL));
    states = (sb_membrane_state *)malloc((size_t)faces * sizeof *states);
    CHECK_OK(sb_body_membrane_states(s->body, s->sheet, states));
    for (int f = 0; f < faces; f++) {
        double along = (double)states[f].tension[0] / (shear * thickness) - (pow(a, 1.5) - pow(a, -1.5));
        double across = (double)states[f].tension[1] / (shear * thickness);
        double turned = fabs((double)states[f].direction.x) - a / sqrt(1 + a * a);
        worst = verify_worse(worst, fabs(along) + fabs(across) + fabs(turned));
    }
    free(states);
    return worst;
}

/* Sheared by 0.3 with all edges held it is stretched by a = g/2 + sqrt(1 + g^2/4) along one diagonal, which carries all
 * that it has, and folds across. */
static void test_sheared(void)
{
    const double g = 0.3, a = g / 2 + sqrt(1 + g * g / 4);
    for (int k = 0; k < 5; k++) {
        square s;
        if (!square_make(&s, names[k], 1))
            return;
        for (int i = 0; i < s.mesh.node_count; i++) {
            sb_vec3 x = s.mesh.nodes[i], to = sb_v3(REAL(g) * x.y, 0, 0);
            double edge = fmin(fmin((double)x.x, 1 - (double)x.x), fmin((double)x.y, 1 - (double)x.y));
            if (edge < 1e-6)
                CHECK_OK(sb_body_prescribe(s.body, &i, 1, SB_X | SB_Y, &to, 1));
        }
        verify_solve(s.body);
        verify("sheet that wrinkles, sheared by 0.3, uneven", names[k], "one diagonal carries mu H (a^3/2 - a^-3/2)",
               "largest error of a face's tensions and direction, over mu H", 0, diagonal_error(&s, a), 1e-7);
        verify_free(s.body, &s.mesh);
    }
}

/* ---- balloons ---- */

/* p = 2 (H/R) mu (a^-1 - a^-7), below its limit at a = 7^1/6: the radius found for the pressure at a. */
static void test_balloon(void)
{
    const double a = 1.2, radius = 1, pressure = 2 * thickness / radius * shear * (1 / a - pow(a, -7));
    static const struct {
        const char *element;
        int around;
        double bound;
    } rows[] = {{"tet4", 6, 4e-3}, {"tet10", 3, 1e-4}, {"hex8", 6, 4e-3}, {"hex20", 3, 5e-4}, {"hex27", 3, 1e-4}};
    for (int k = 0; k < 5; k++) {
        sb_mesh mesh = verify_octant(verify_element_named(rows[k].element)->type, 0.9, radius, 1, rows[k].around, 0);
        sb_body *body = verify_body(&mesh, verify_element_named(rows[k].element),
                                    sb_material_neo_hookean(REAL(1e-7 * shear), 0, 1000));
        sb_membrane_def sheet = sb_default_membrane_def();
        char name[96];
        int *faces;
        sheet.corners = verify_face_corners(&mesh);
        sheet.face_count = verify_faces(&mesh, verify_on_sphere, &radius, sheet.corners, &faces);
        sheet.faces = faces;
        sheet.thickness = REAL(thickness), sheet.shear = REAL(shear);
        CHECK_OK(sb_body_add_membrane(body, &sheet, NULL, NULL));
        free(faces);
        verify_hold_symmetry(body, &mesh, 3);
        verify_press(body, &mesh, verify_on_sphere, &radius, -pressure);
        verify_solve(body);
        snprintf(name, sizeof name, "balloon at 1.2 of its radius, octant, 3 of %dx%d", rows[k].around, rows[k].around);
        verify(name, rows[k].element, "p = 2 (H/R) mu (1/a - a^-7)", "stretch a", a,
               1 + verify_outward(body, &mesh, verify_on_sphere, radius) / radius, rows[k].bound);
        verify_free(body, &mesh);
    }
}

/* ---- cavities ---- */

/* A whole thick sphere of eight octants. */
static sb_mesh whole_sphere(sb_element_type type, double inner, double outer, int across, int around, int even)
{
    sb_mesh whole;
    memset(&whole, 0, sizeof whole);
    for (int k = 0; k < 8; k++) {
        sb_mesh part = verify_octant(type, inner, outer, across, around, even);
        for (int i = 0; i < part.node_count; i++) {
            sb_vec3 x = part.nodes[i];
            for (int turn = 0; turn < k % 4; turn++)
                x = sb_v3(-x.y, x.x, x.z);
            part.nodes[i] = k < 4 ? x : sb_v3(x.x, -x.y, -x.z);
        }
        verify_append(&whole, &part);
    }
    CHECK_OK(sb_mesh_merge_nodes(&whole, REAL(-1), NULL, NULL));
    return whole;
}

/* A cavity of the faces on a sphere. */
static int fill_sphere(sb_body *body, const sb_mesh *mesh, double radius, sb_cavity_kind kind)
{
    sb_cavity_def def = sb_default_cavity_def();
    int *faces, id = 0;
    def.corners = verify_face_corners(mesh);
    def.face_count = verify_faces(mesh, verify_on_sphere, &radius, def.corners, &faces);
    def.faces = faces;
    def.kind = kind;
    CHECK_OK(sb_body_add_cavity(body, &def, &id, NULL));
    free(faces);
    return id;
}

/* 4/3 pi a^3 of the hole in a thick sphere. */
static void test_sphere_volume(void)
{
    static const double bounds[5] = {0.012, 2e-4, 0.012, 5e-4, 1e-4};
    for (int k = 0; k < 5; k++) {
        const double a = 0.7;
        sb_mesh mesh = whole_sphere(verify_element_named(names[k])->type, a, 1, 1, k == 0 || k == 2 ? 6 : 3, 0);
        sb_body *body = verify_body(&mesh, verify_element_named(names[k]), sb_material_neo_hookean(1000, 0, 1000));
        int id = fill_sphere(body, &mesh, a, SB_CAVITY_PRESSURE);
        sb_real volume = 0;
        CHECK_OK(sb_body_cavity_volume(body, id, &volume));
        verify("hole of a thick sphere, 24 of 3x3 faces (linear 6x6)", names[k], "4/3 pi a^3", "volume (m^3)",
               4 * VERIFY_PI / 3 * a * a * a, (double)volume, bounds[k]);
        verify_free(body, &mesh);
    }
}

static void filled_case(const char *type, int liquid, int even, double bound)
{
    const double a = 1, b = 2, young = 1000, poisson = 0.3, share = 1e-6, bulk = liquid ? 2.2e9 : 1e30;
    const double mu = young / (2 * (1 + poisson)), modulus = young / (3 * (1 - 2 * poisson));
    double soft = a / (4 * mu * (b * b * b - a * a * a)) * (4 * mu * a * a * a / (3 * modulus) + b * b * b);
    const verify_element *element = verify_element_named(type);
    sb_mesh mesh = whole_sphere(element->type, a, b, 2, 2, even);
    sb_body *body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(poisson), 1000));
    int id = fill_sphere(body, &mesh, a, liquid ? SB_CAVITY_LIQUID : SB_CAVITY_VOLUME);
    sb_real before = 0, after = 0, pressure = 0;
    char name[96];
    verify_hold_symmetry(body, &mesh, 3);
    CHECK_OK(sb_body_cavity_volume(body, id, &before));
    CHECK_OK(sb_body_inject_cavity(body, id, REAL(share) * before));
    verify_solve(body);
    CHECK_OK(sb_body_cavity_volume(body, id, &after));
    CHECK_OK(sb_body_cavity_pressure(body, id, &pressure));
    snprintf(name, sizeof name, "thick sphere b/a = 2%s, 24 of 2x2x2%s",
             liquid ? " with a millionth of its water more" : ", hole grown by a millionth", verify_gradings[even]);
    verify(name, type, "Lame", "pressure (Pa)", share / (3 * soft / a), (double)pressure, bound);
    snprintf(name, sizeof name, "thick sphere%s%s",
             liquid ? " with a millionth of its water more" : ", hole grown by a millionth", verify_gradings[even]);
    verify(name, type, "the law", "error of its volume, over what was injected", 0,
           ((double)after / (double)before - (1 + share) * (1 - (double)pressure / bulk)) / share, 1e-5);
    verify_free(body, &mesh);
}

/* A millionth of the volume more in a thick sphere: u(a) = p a / (4 mu (b^3 - a^3)) (4 mu a^3 / (3 K) + b^3). */
static void test_filled_sphere(void)
{
    static const char *const types[2] = {"tet10", "hex20"};
    static const double bounds[2][2] = {{4e-3, 0.01}, {4e-3, 0.009}}; /* graded, even */
    for (int k = 0; k < 2; k++)
        for (int liquid = 0; liquid < 2; liquid++)
            for (int even = 0; even < 2; even++)
                filled_case(types[k], liquid, even, bounds[k][even]);
}

static void test_table(void) { verify_table("verification_membranes"); }

CHECK_SUITE(verification_membranes, {"strip", test_strip}, {"biaxial", test_biaxial}, {"sheared", test_sheared},
            {"balloon", test_balloon}, {"volume", test_sphere_volume}, {"filled", test_filled_sphere},
            {"table", test_table});
