/* When a static solve is done: random thin and thick bodies against the converged answer, clamps that hold far more
 * than the load, a slit plate, the floor that rounding sets. */
#include "softbody.h"

#include "check.h"
#include "scene.h"
#include "verification_scene.h"

/* ---- random bodies ---- */

typedef struct random_body {
    sb_mesh mesh;
    sb_body *body;
    sb_vec3 *loads; /* [node_count] (N) */
    double tolerance;
} random_body;

static double log_random(unsigned long long *seed, double low, double high)
{
    return low * pow(high / low, check_random(seed));
}

/* Cells along, across and through; a thickness of 1/2 to 1/200 of the length, in float 1/10. */
static random_body make_random(unsigned long long *seed)
{
    static const sb_element_type types[4] = {SB_TET10, SB_HEX8, SB_HEX20, SB_TET4};
    static const sb_precond_kind solvers[3] = {SB_PRECOND_CHOLESKY, SB_PRECOND_IC0, SB_PRECOND_MULTIGRID};
    double length = log_random(seed, 1e-2, 10), young = log_random(seed, 1e2, 1e9);
    double width = length * log_random(seed, 0.05, 1),
           height = length * log_random(seed, SB_REAL_IS_FLOAT ? 0.1 : 0.005, 0.5);
    double bend = log_random(seed, 1e-3, 0.3), force, nu = check_random_in(seed, 0, 0.45);
    sb_element_type type = types[(int)(4 * check_random(seed))];
    int quadratic = type == SB_TET10 || type == SB_HEX20, ends;
    sb_body_def def = sb_default_body_def();
    random_body r;
    memset(&r, 0, sizeof r);
    r.mesh = scene_box(type, quadratic ? 8 : 16, quadratic ? 2 : 4, quadratic ? 1 : 2,
                       sb_v3(REAL(length), REAL(width), REAL(height)), 0.1);
    def.mesh = &r.mesh;
    def.preconditioner = solvers[(int)(3 * check_random(seed))];
    switch ((int)(4 * check_random(seed))) {
    case 0: def.material = sb_material_linear(REAL(young), REAL(nu), 1000); break;
    case 1: def.material = sb_material_svk(REAL(young), REAL(nu), 1000); break;
    case 2: def.material = sb_material_corotated(REAL(young), REAL(nu), 1000); break;
    default: def.material = sb_material_neo_hookean(REAL(young), REAL(nu), 1000); break;
    }
    r.body = scene_body(&def);
    ends = check_random(seed) < 0.3;
    scene_fix_plane(r.body, &r.mesh, 0, 0, SB_XYZ);
    if (ends)
        scene_fix_plane(r.body, &r.mesh, 0, length, SB_XYZ);
    r.loads = (sb_vec3 *)calloc((size_t)r.mesh.node_count, sizeof(sb_vec3));
    force = young * width * pow(height, 3) / (4 * length * length) * bend * (ends ? 50 : 1);
    for (int k = 0; k < 10; k++) {
        int i = (int)(r.mesh.node_count * check_random(seed));
        r.loads[i].z += REAL(force * check_random_in(seed, 0, 0.2));
        r.loads[i].y += REAL(force * check_random_in(seed, -0.1, 0.1));
        r.loads[i].x += REAL(force * check_random_in(seed, -0.1, 0.1));
    }
    r.tolerance = log_random(seed, 1e-4, 0.1);
    return r;
}

static sb_static_report solve_to(random_body *r, double tolerance, sb_vec3 *found)
{
    size_t size = (size_t)r->mesh.node_count * sizeof(sb_vec3);
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    sb_vec3 *rest = (sb_vec3 *)calloc((size_t)r->mesh.node_count, sizeof(sb_vec3));
    options.tolerance = REAL(tolerance);
    options.max_newton = 200;
    sb_body_clear_loads(r->body);
    CHECK_OK(sb_body_set_displacements(r->body, rest));
    for (int i = 0; i < r->mesh.node_count; i++)
        CHECK_OK(sb_body_add_forces(r->body, &i, 1, &r->loads[i], 1));
    if (!CHECK_OK(sb_body_solve_static(r->body, &options, &info)))
        printf("%s\n", info.error.message);
    memcpy(found, sb_body_displacements(r->body), size);
    free(rest);
    return info.statics;
}

/* Mean displacement under the loads that is off, over it. */
static double load_error(const random_body *r, const sb_vec3 *found, const sb_vec3 *exact)
{
    double off = 0, all = 0;
    for (int i = 0; i < r->mesh.node_count; i++) {
        off += (double)sb_v3_dot(r->loads[i], sb_v3_sub(found[i], exact[i]));
        all += fabs((double)sb_v3_dot(r->loads[i], exact[i]));
    }
    return fabs(off) / all;
}

static void test_estimate(void)
{
    unsigned long long seed = 12345;
    double most = 0;
    for (int k = 0; k < check_rounds(20); k++) {
        random_body r = make_random(&seed);
        size_t n = (size_t)r.mesh.node_count;
        sb_vec3 *found = (sb_vec3 *)malloc(n * sizeof *found), *exact = (sb_vec3 *)malloc(n * sizeof *exact);
        sb_static_report loose = solve_to(&r, r.tolerance, found), tight = solve_to(&r, 1e-10, exact);
        double off = load_error(&r, found, exact), bound = sqrt((double)(loose.energy + tight.energy));
        CHECK(loose.reason != SB_STOP_NONE && tight.reason != SB_STOP_NONE);
        CHECK(loose.energy >= 0 && loose.increment >= 0 && loose.floor >= 0);
        if (loose.reason == SB_STOP_CONVERGED)
            CHECK((double)loose.force <= r.tolerance && (double)loose.energy <= 0.01 * r.tolerance);
        if (!CHECK(off <= bound))
            printf("%d: tolerance %g: %g off, at most %g told\n", k, r.tolerance, off, bound);
        most = fmax(most, off);
        free(found);
        free(exact);
        free(r.loads);
        verify_free(r.body, &r.mesh);
    }
    printf("  largest error %g\n", most);
}

/* ---- clamps that hold a million times the load ---- */

static double stretched_plate(double tolerance, double *told)
{
    const double young = 1e6, stretch = 0.02, height = 0.01, length = 1, width = 0.5;
    const double tension = young * stretch * height * width;
    sb_mesh mesh = scene_box(SB_HEX20, 8, 3, 1, sb_v3(REAL(length), REAL(width), REAL(height)), 0);
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_vec3 pull = sb_v3(REAL(stretch * length), 0, 0), down = sb_v3(0, 0, REAL(-1e-6 * tension / mesh.node_count));
    const verify_plane end = {0, length}, middle = {0, length / 2};
    sb_step_info info;
    double sag;
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_svk(REAL(young), 0, 1000);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    verify_move(body, &mesh, verify_on_plane, &end, SB_XYZ, pull);
    options.tolerance = REAL(tolerance);
    CHECK_OK(sb_body_solve_static(body, &options, &info));
    for (int i = 0; i < mesh.node_count; i++)
        CHECK_OK(sb_body_add_forces(body, &i, 1, &down, 1));
    CHECK_OK(sb_body_solve_static(body, &options, &info));
    *told = (double)info.statics.force;
    sag = -(double)verify_mean(body, &mesh, verify_on_plane, &middle).z;
    verify_free(body, &mesh);
    return sag;
}

/* Stretched by its clamps, and then loaded. */
static void test_clamps(void)
{
    double told, exact, sag;
    if (SB_REAL_IS_FLOAT) { /* the load is below what the tension's digits show */
        CHECK_SKIP("a load of 1e-6 of the tension");
        return;
    }
    exact = stretched_plate(1e-11, &told);
    sag = stretched_plate(1e-4, &told);
    printf("  sag %.9g, at 1e-4 %.9g\n", exact, sag);
    CHECK(exact > 0);
    CHECK_NEAR(sag, exact, 0.01 * exact);
    CHECK(told <= 1e-4);
}

/* ---- a slit annular plate: Sze, Liu and Lo 2004, 3.4, under a fraction of their load ---- */

static sb_vec3 map_annulus(const void *user, double x, double y, double z)
{
    const double *thickness = (const double *)user, r = 6 + 4 * x, a = 2 * VERIFY_PI * y;
    return sb_v3(REAL(r * cos(a)), REAL(r * sin(a)), REAL(*thickness * (z - 0.5)));
}

enum { ROUND = 12, ACROSS = 2, CLAMPED = 1, LIFTED = 2 };

/* Which nodes are on which side of the slit: those of both lie at the same places. */
static unsigned char *slit_sides(const sb_mesh *mesh, int *lifted)
{
    unsigned char *side = (unsigned char *)calloc((size_t)mesh->node_count, 1);
    *lifted = 0;
    for (int e = 0; e < mesh->element_count; e++)
        for (int a = 0; a < 20; a++) {
            sb_real xi[3];
            int i = mesh->elements[20 * e + a], row = e / ACROSS % ROUND;
            sb_element_node_point(SB_HEX20, a, xi);
            if (row == 0 && xi[1] < REAL(-0.9))
                side[i] = LIFTED;
            if (row == ROUND - 1 && xi[1] > REAL(0.9))
                side[i] = CLAMPED;
        }
    for (int i = 0; i < mesh->node_count; i++)
        *lifted += side[i] == LIFTED;
    return side;
}

/* Largest lift (m) under a line load (N/m). */
static double slit_plate(double load, double tolerance, sb_precond_kind solver, sb_step_info *info)
{
    const double thickness = 0.03;
    sb_mesh mesh = verify_block(SB_HEX20, ACROSS, ROUND, 1, map_annulus, &thickness, 0);
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    double lift = 0;
    int lifted;
    unsigned char *side = slit_sides(&mesh, &lifted);
    sb_vec3 force = sb_v3(0, 0, REAL(4 * load / lifted));
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_svk(REAL(21e6), 0, 1000);
    def.preconditioner = solver;
    body = scene_body(&def);
    for (int i = 0; i < mesh.node_count; i++) {
        if (side[i] == CLAMPED)
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_XYZ));
        if (side[i] == LIFTED)
            CHECK_OK(sb_body_add_forces(body, &i, 1, &force, 1));
    }
    options.tolerance = REAL(tolerance);
    options.max_newton = 200;
    CHECK_OK(sb_body_solve_static(body, &options, info));
    for (int i = 0; i < mesh.node_count; i++)
        lift = fmax(lift, (double)sb_body_displacements(body)[i].z);
    free(side);
    verify_free(body, &mesh);
    return lift;
}

static void test_slit_plate(void)
{
    sb_step_info info;
    double exact, loose;
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("thickness 1/300");
        return;
    }
    exact = slit_plate(0.01, 1e-9, SB_PRECOND_CHOLESKY, &info);
    printf("  lift %g m in %d iterations\n", exact, info.newton_iterations);
    loose = slit_plate(0.01, 1e-2, SB_PRECOND_CHOLESKY, &info);
    printf("  lift %g m in %d iterations\n", loose, info.newton_iterations);
    CHECK_NEAR(loose, exact, 0.01 * exact);
}

/* ---- rounding ---- */

static void test_floor(void)
{
    unsigned long long seed = 77;
    int floors = 0;
    for (int k = 0; k < 6; k++) {
        random_body r = make_random(&seed);
        size_t n = (size_t)r.mesh.node_count;
        sb_vec3 *found = (sb_vec3 *)malloc(n * sizeof *found);
        sb_static_report report = solve_to(&r, 1e-30, found);
        CHECK(report.reason != SB_STOP_NONE);
        CHECK(report.energy >= 0 && report.energy < (SB_REAL_IS_FLOAT ? 1 : REAL(1e-12)));
        floors += report.reason == SB_STOP_FLOOR;
        free(found);
        free(r.loads);
        verify_free(r.body, &r.mesh);
    }
    CHECK(floors > 0);
}

/* What a report says where nothing was solved, and where a solve fails. */
static void test_report(void)
{
    unsigned long long seed = 5;
    random_body r = make_random(&seed);
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    sb_vec3 huge = sb_v3(REAL(1e3), REAL(1e9), REAL(1e9));
    CHECK_OK(sb_body_solve_static(r.body, NULL, &info));
    CHECK_INT(info.statics.reason, SB_STOP_CONVERGED);
    CHECK(info.statics.energy == -1 && info.statics.increment == -1 && info.statics.force == 0);
    CHECK_INT(info.statics.iterations, 0);
    for (int i = 0; i < r.mesh.node_count; i++)
        CHECK_OK(sb_body_add_forces(r.body, &i, 1, &huge, 1));
    options.max_newton = 2;
    options.max_iterations = 1;
    if (sb_body_solve_static(r.body, &options, &info) != SB_OK)
        CHECK_INT(info.statics.reason, SB_STOP_NONE);
    CHECK_OK(sb_body_step(r.body, REAL(1e-6), &info));
    CHECK_INT(info.statics.reason, SB_STOP_NONE);
    free(r.loads);
    verify_free(r.body, &r.mesh);
}

CHECK_SUITE(static_done, {"estimate bounds the error", test_estimate}, {"clamps", test_clamps},
            {"slit plate", test_slit_plate}, {"floor", test_floor}, {"report", test_report});
