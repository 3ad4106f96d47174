/* Thin bodies: iterations that do not depend on thinness, published shells, solvers that see them. */
#include "softbody.h"

#include "check.h"
#include "scene.h"
#include "verification_scene.h"

/* ---- a strip bent by a force at its tip ---- */

static sb_material material_of(int model, double young)
{
    const sb_real e = REAL(young), none = 0;
    switch (model) {
    case 0: return sb_material_svk(e, none, 1000);
    case 1: return sb_material_neo_hookean(e, REAL(0.3), 1000);
    case 2: return sb_material_corotated(e, none, 1000);
    default: return sb_material_stable_neo_hookean(e, REAL(0.3), 1000);
    }
}

/* PL^2/EI = share; L/h = thinness, width 10 h. Returns the tip's way over L. */
static double strip(sb_element_type type, int model, double thinness, double share, sb_newton newton,
                    sb_step_info *info)
{
    const double young = 1e6, length = 1, height = length / thinness, width = 10 * height;
    const verify_plane end = {0, length};
    sb_mesh mesh = scene_box(type, 20, 1, 1, sb_v3(REAL(length), REAL(width), REAL(height)), 0);
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    double force = share * young * width * pow(height, 3) / 12 / (length * length), tip;
    int count = 0;
    sb_vec3 each;
    sb_body *body;
    def.mesh = &mesh;
    def.material = material_of(model, young);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int i = 0; i < mesh.node_count; i++)
        count += verify_on_plane(&end, mesh.nodes[i]);
    each = sb_v3(0, 0, REAL(force / count));
    for (int i = 0; i < mesh.node_count; i++)
        if (verify_on_plane(&end, mesh.nodes[i]))
            CHECK_OK(sb_body_add_forces(body, &i, 1, &each, 1));
    options.newton = newton;
    options.max_newton = 400;
    CHECK_OK(sb_body_solve_static(body, &options, info));
    tip = (double)verify_mean(body, &mesh, verify_on_plane, &end).z / length;
    verify_free(body, &mesh);
    return tip;
}

static void test_strip(void)
{
    const double thinness[3] = {100, 300, 1000};
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("digits of double");
        return;
    }
    for (int model = 0; model < 4; model++)
        for (int k = 0; k < 3; k++) {
            sb_step_info info;
            double tip = strip(SB_HEX20, model, thinness[k], 1, SB_NEWTON_AUTO, &info);
            printf("  L/h %g, model %d: tip %.6f L in %d iterations\n", thinness[k], model, tip,
                   info.newton_iterations);
            CHECK(info.newton_iterations <= 30 && info.load_steps == 1);
            CHECK_INT(info.statics.newton, SB_NEWTON_MIXED_POINTS);
            CHECK_INT(info.statics.solver, SB_PRECOND_CHOLESKY);
        }
}

/* ---- Sze, Liu and Lo 2004 ---- */

/* A plate bent to a ring around the slit: the unit cube's y goes round from the clamped to the free side. */
static sb_vec3 map_annulus(const void *user, double x, double y, double z)
{
    const double *thickness = (const double *)user, r = 6 + 4 * x, a = 2 * VERIFY_PI * y;
    return sb_v3(REAL(r * cos(a)), REAL(r * sin(a)), REAL(*thickness * (z - 0.5)));
}

/* Lift of the slit's free side at its outer and inner radius under a line load (N/m). */
static void slit_plate(int across, int around, double load, double lift[2], sb_step_info *info)
{
    const double thickness = 0.03;
    sb_mesh mesh = verify_block(SB_HEX20, across, around, 1, map_annulus, &thickness, 0);
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    unsigned char *side = (unsigned char *)calloc((size_t)mesh.node_count, 1);
    int lifted = 0;
    sb_vec3 force;
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_svk(REAL(21e6), 0, 1000);
    body = scene_body(&def);
    for (int e = 0; e < mesh.element_count; e++)
        for (int a = 0; a < 20; a++) {
            sb_real xi[3];
            int row = e / across % around;
            sb_element_node_point(SB_HEX20, a, xi);
            if (row == 0 && xi[1] < REAL(-0.9))
                side[mesh.elements[20 * e + a]] = 1;
            if (row == around - 1 && xi[1] > REAL(0.9))
                side[mesh.elements[20 * e + a]] = 2;
        }
    for (int i = 0; i < mesh.node_count; i++)
        lifted += side[i] == 1;
    force = sb_v3(0, 0, REAL(4 * load / lifted));
    for (int i = 0; i < mesh.node_count; i++) {
        if (side[i] == 2)
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_XYZ));
        if (side[i] == 1)
            CHECK_OK(sb_body_add_forces(body, &i, 1, &force, 1));
    }
    lift[0] = lift[1] = 0;
    options.load_steps = 8;
    CHECK_OK(sb_body_solve_static(body, &options, info));
    for (int i = 0; i < mesh.node_count; i++)
        if (side[i] == 1) {
            double z = (double)sb_body_displacements(body)[i].z, x = (double)mesh.nodes[i].x;
            if (x > 9.99)
                lift[0] = z;
            if (x < 6.01)
                lift[1] = z;
        }
    free(side);
    verify_free(body, &mesh);
}

static void test_slit_plate(void)
{
    double lift[2];
    sb_step_info info;
    if (check_quick() || getenv("CHECK_SHORT") || SB_REAL_IS_FLOAT) {
        CHECK_SKIP("a quarter of a minute, in double");
        return;
    }
    slit_plate(4, 72, 0.8, lift, &info);
    printf("  slit plate: %.4f and %.4f m in %d iterations\n", lift[0], lift[1], info.newton_iterations);
    CHECK_NEAR(lift[0], 17.528, 0.02 * 17.528);
    CHECK_NEAR(lift[1], 13.891, 0.02 * 13.891);
}

/* An octant of the open cylinder: x goes round from the load's plane, y along from the middle. */
static sb_vec3 map_cylinder(const void *user, double x, double y, double z)
{
    const double *size = (const double *)user, a = VERIFY_PI / 2 * x, r = size[0] + size[2] * (z - 0.5);
    return sb_v3(REAL(x == 1 ? r : r * sin(a)), REAL(size[1] / 2 * y), REAL(x == 1 ? 0 : r * cos(a)));
}

static double cylinder(int round, int along, double pull, sb_step_info *info)
{
    const double size[3] = {4.953, 10.35, 0.094};
    sb_mesh mesh = verify_block(SB_HEX20, round, along, 1, map_cylinder, size, 0);
    sb_body_def def = sb_default_body_def();
    double way = 0;
    int pulled = -1;
    sb_vec3 force = sb_v3(0, 0, REAL(pull / 4));
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_svk(REAL(10.5e6), REAL(0.3125), 1000);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_X);
    scene_fix_plane(body, &mesh, 1, 0, SB_Y);
    scene_fix_plane(body, &mesh, 2, 0, SB_Z);
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 x = mesh.nodes[i];
        if (x.x < REAL(1e-9) && x.y < REAL(1e-9) && (pulled < 0 || x.z > mesh.nodes[pulled].z))
            pulled = i;
    }
    CHECK_OK(sb_body_add_forces(body, &pulled, 1, &force, 1));
    CHECK_OK(sb_body_solve_static(body, NULL, info));
    way = (double)sb_body_displacements(body)[pulled].z;
    verify_free(body, &mesh);
    return way;
}

static void test_cylinder(void)
{
    sb_step_info info;
    double way;
    if (check_quick() || getenv("CHECK_SHORT") || SB_REAL_IS_FLOAT) {
        CHECK_SKIP("a quarter of a minute, in double");
        return;
    }
    way = cylinder(28, 18, 40e3, &info);
    printf("  cylinder: %.4f m in %d iterations\n", way, info.newton_iterations);
    CHECK_NEAR(way, 2.768, 0.02 * 2.768);
}

CHECK_SUITE(thin, {"strip", test_strip}, {"slit plate", test_slit_plate}, {"cylinder", test_cylinder});
