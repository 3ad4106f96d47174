/* Properties that hold exactly on every mesh: patch tests, indifference to rigid motion, mass and loads in
 * sum. */
#include "verification_scene.h"

static const double young = 5e3, poisson = 0.4, density = 1000, exact = 1e-8;

static sb_material make(const verify_material *material)
{
    return material->make(REAL(young), REAL(poisson), REAL(density));
}

/* The unit cube, its inside distorted. */
static sb_mesh cube(sb_element_type type, int straight)
{
    static const double amplitude = 0.05;
    return verify_block(type, 3, 3, 3, verify_map_distorted, &amplitude, straight);
}

/* A box whose sides are distorted as well, far from the origin. */
static sb_vec3 map_anywhere(const void *user, double x, double y, double z)
{
    (void)user;
    return sb_v3(REAL(1 + 0.9 * x + 0.05 * sin(5 * y)), REAL(-2 + 0.7 * y + 0.05 * sin(4 * z + x)),
                 REAL(3 + 0.5 * z + 0.03 * sin(6 * x)));
}

static sb_mesh anywhere(sb_element_type type) { return verify_block(type, 2, 2, 2, map_anywhere, NULL, 1); }

/* ---- patch tests ---- */

static const double affine[3][3] = {{1.15, 0.1, -0.05}, {0.06, 0.9, 0.08}, {-0.02, 0.04, 1.1}};

static sb_mat3 affine_gradient(void)
{
    sb_mat3 F;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            F.m[i][j] = REAL(affine[i][j]);
    return F;
}

static sb_vec3 affine_displacement(sb_vec3 x) { return sb_v3_sub(sb_m3_apply(affine_gradient(), x), x); }

/* Largest difference of a stress at any point from the stress of F, relative to Young's modulus. */
static double stress_error(const sb_body *body, const sb_material *material, sb_mat3 F)
{
    double worst = 0;
    sb_mat3 P, wanted;
    CHECK(sb_material_stress(material, &F, NULL, &P));
    wanted = sb_material_cauchy_stress(material, F, P);
    for (int e = 0; e < sb_body_element_count(body); e++)
        for (int q = 0; q < sb_body_point_count(body); q++) {
            sb_mat3 stress;
            if (!CHECK_OK(sb_body_stress(body, e, q, &stress)))
                return 1;
            for (int k = 0; k < 9; k++)
                worst = verify_worse(worst, fabs((double)(stress.m[k / 3][k % 3] - wanted.m[k / 3][k % 3])) / young);
        }
    return worst;
}

/* The surface follows an affine motion; the inside must find it. Largest error of displacement and stress. */
static double patch_error(const verify_element *element, sb_material material, int straight)
{
    sb_mesh mesh = cube(element->type, straight);
    sb_body *body = verify_body(&mesh, element, material);
    double worst = 0;
    scene_fix_boundary(body, &mesh);
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 u = affine_displacement(mesh.nodes[i]);
        if (sb_body_supports(body)[i])
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u, 1));
    }
    verify_solve(body);
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 u = affine_displacement(mesh.nodes[i]);
        worst = verify_worse(worst, (double)sb_v3_norm(sb_v3_sub(sb_body_displacements(body)[i], u)));
    }
    worst = verify_worse(worst, stress_error(body, &material, affine_gradient()));
    verify_free(body, &mesh);
    return worst;
}

static void test_patch(void)
{
    static const char *source = "Irons and Razzaque 1972: x = A X on the surface";
    for (int e = 0; e < VERIFY_ELEMENTS; e++) {
        const verify_element *element = verify_elements + e;
        double curved = 0;
        for (int m = 0; m < VERIFY_MATERIALS; m++) {
            sb_material material = make(verify_materials + m);
            char what[80];
            if (!verify_suits(element, material.model))
                continue;
            snprintf(what, sizeof what, "%s, %s", element->name, verify_materials[m].name);
            verify("patch test, distorted 3x3x3", what, source, "largest error of u/size and stress/E", 0,
                   patch_error(element, material, 1), exact);
            if (element->degree > 1 && !element->single_rotation)
                curved = verify_worse(curved, patch_error(element, material, 0));
        }
        if (element->degree > 1 && !element->single_rotation)
            verify("patch test, curved 3x3x3", element->name, source, "largest error of u/size and stress/E", 0, curved,
                   exact);
    }
}

/* A bar pulled by tractions on both ends, held against rigid motion only: uniform uniaxial stress. */
static double traction_patch_error(const verify_element *element)
{
    static const double stress = 100;
    static const verify_plane left = {0, 0}, right = {0, 1};
    sb_mesh mesh = cube(element->type, 1);
    sb_body *body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(poisson), REAL(density)));
    sb_vec3 pull = sb_v3(REAL(stress), 0, 0), push = sb_v3(REAL(-stress), 0, 0);
    double worst = 0;
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 x = mesh.nodes[i];
        int axes = 0;
        if (x.x == 0 && x.y == 0 && x.z == 0)
            axes = SB_XYZ;
        else if (x.x == 1 && x.y == 0 && x.z == 0)
            axes = SB_Y | SB_Z;
        else if (x.x == 0 && x.y == 1 && x.z == 0)
            axes = SB_Z;
        if (axes)
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, axes));
    }
    verify_load(body, &mesh, verify_on_plane, &left, verify_uniform, &push);
    verify_load(body, &mesh, verify_on_plane, &right, verify_uniform, &pull);
    verify_solve(body);
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 x = mesh.nodes[i], u = sb_v3(x.x, REAL(-poisson) * x.y, REAL(-poisson) * x.z);
        u = sb_v3_sub(sb_v3_scale(REAL(young / stress), sb_body_displacements(body)[i]), u);
        worst = verify_worse(worst, (double)sb_v3_norm(u));
        worst = verify_worse(worst, (double)sb_v3_norm(sb_body_reactions(body)[i]) / stress);
    }
    verify_free(body, &mesh);
    return worst;
}

static void test_traction_patch(void)
{
    for (int e = 0; e < VERIFY_ELEMENTS; e++)
        if (verify_suits(verify_elements + e, SB_LINEAR))
            verify("patch test by tractions, distorted 3x3x3", verify_elements[e].name,
                   "Hooke: u = s/E (x, -nu y, -nu z)", "largest error of u E/s, and of the reactions", 0,
                   traction_patch_error(verify_elements + e), exact);
}

/* ---- rigid motion ---- */

static sb_quat turn(double angle)
{
    return sb_quat_from_rotation_vector(sb_v3(REAL(0.48 * angle), REAL(-0.6 * angle), REAL(0.64 * angle)));
}

/* Some large deformation without symmetry; amplitude 0: none. Then a rotation by `angle` and a shift. */
static sb_vec3 moved(sb_vec3 x, double amplitude, double angle)
{
    double a = amplitude;
    sb_vec3 y = sb_v3(x.x + REAL(a * sin(2 * (double)x.y)), x.y + REAL(a * cos(3 * (double)x.z)),
                      x.z + REAL(a * sin((double)x.x * 2 + 1)));
    return sb_v3_add(sb_m3_apply(sb_quat_to_mat3(turn(angle)), y), sb_v3(REAL(0.3 * angle), 2, -1));
}

/* Internal forces and energy of the deformed and moved body; its nodes are all held. */
static double forces_of(const verify_element *element, sb_material material, double amplitude, double angle,
                        sb_vec3 *forces)
{
    sb_mesh mesh = anywhere(element->type);
    sb_body *body = verify_body(&mesh, element, material);
    sb_vec3 *u = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
    sb_energy energy = {0, 0, 0};
    for (int i = 0; i < mesh.node_count; i++)
        u[i] = sb_v3_sub(moved(mesh.nodes[i], amplitude, angle), mesh.nodes[i]);
    CHECK_OK(sb_body_set_displacements(body, u));
    for (int i = 0; i < mesh.node_count; i++)
        CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_XYZ));
    CHECK_OK(sb_body_solve_static(body, NULL, NULL));
    CHECK_OK(sb_body_energy(body, &energy));
    memcpy(forces, sb_body_reactions(body), (size_t)mesh.node_count * sizeof(sb_vec3));
    free(u);
    verify_free(body, &mesh);
    return (double)energy.elastic;
}

enum { MOST_NODES = 400 };

static double largest(const sb_vec3 *f)
{
    double size = 0;
    for (int i = 0; i < MOST_NODES; i++)
        size = verify_worse(size, (double)sb_v3_norm(f[i]));
    return size;
}

/* *energy, *force: relative changes when the deformed body is turned by 2 rad. */
static void turn_error(const verify_element *element, sb_material material, double *energy, double *force)
{
    sb_vec3 before[MOST_NODES], after[MOST_NODES];
    double first, second, worst = 0;
    memset(before, 0, sizeof before);
    memset(after, 0, sizeof after);
    first = forces_of(element, material, 0.15, 0, before);
    second = forces_of(element, material, 0.15, 2, after);
    CHECK(first > 1 && largest(before) > 1);
    *energy = verify_worse(*energy, fabs(second / first - 1));
    for (int i = 0; i < MOST_NODES; i++)
        worst = verify_worse(worst,
                             (double)sb_v3_norm(sb_v3_sub(after[i], sb_m3_apply(sb_quat_to_mat3(turn(2)), before[i]))));
    *force = verify_worse(*force, worst / largest(before));
}

static void test_rigid(void)
{
    for (int m = 0; m < VERIFY_MATERIALS; m++) {
        sb_material material = make(verify_materials + m);
        double energy = 0, force = 0, rest = 0;
        if (material.model == SB_LINEAR)
            continue;
        for (int e = 0; e < VERIFY_ELEMENTS; e++) {
            sb_vec3 forces[MOST_NODES];
            if (!verify_suits(verify_elements + e, material.model))
                continue;
            turn_error(verify_elements + e, material, &energy, &force);
            memset(forces, 0, sizeof forces);
            forces_of(verify_elements + e, material, 0, 3, forces);
            rest = verify_worse(rest, largest(forces) / young);
        }
        verify("turned by 2 rad and moved", verify_materials[m].name, "W(Q F) = W(F)", "change of energy, relative", 0,
               energy, exact);
        verify("turned by 2 rad and moved", verify_materials[m].name, "P(Q F) = Q P(F)",
               "change of forces, relative to the largest", 0, force, exact);
        verify("undeformed, turned by 3 rad", verify_materials[m].name, "P(Q) = 0", "largest force / (E m^2)", 0, rest,
               exact);
    }
}

/* The linear model strains under finite rotations; not under u = c + w x X. */
static void test_infinitesimal(void)
{
    double worst = 0;
    for (int e = 0; e < VERIFY_ELEMENTS; e++) {
        sb_mesh mesh;
        sb_body *body;
        sb_vec3 *u;
        if (!verify_suits(verify_elements + e, SB_LINEAR))
            continue;
        mesh = anywhere(verify_elements[e].type);
        body = verify_body(&mesh, verify_elements + e, make(verify_materials));
        u = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
        for (int i = 0; i < mesh.node_count; i++) {
            u[i] = sb_v3_cross(sb_v3(REAL(0.1), REAL(-0.2), REAL(0.3)), mesh.nodes[i]);
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, u + i, 1));
        }
        CHECK_OK(sb_body_solve_static(body, NULL, NULL));
        for (int i = 0; i < mesh.node_count; i++)
            worst = verify_worse(worst, (double)sb_v3_norm(sb_body_reactions(body)[i]) / young);
        free(u);
        verify_free(body, &mesh);
    }
    verify("infinitesimal rotation 0.1, -0.2, 0.3", "linear", "sym grad (w x X) = 0", "largest force / (E m^2)", 0,
           worst, exact);
}

/* ---- mass and loads ---- */

/* Energy of a box a x b x c (m) that spins around z through its corner: rho a b c (a^2 + b^2)/3 w^2/2. The
 * integrand is a polynomial of degree 2, which consistent masses hold exactly. */
static void test_mass(void)
{
    static const double a = 0.9, b = 0.7, c = 0.5, w = 2;
    for (int e = 0; e < VERIFY_ELEMENTS; e++) {
        sb_mesh mesh;
        sb_body_def def;
        sb_body *body;
        sb_vec3 *v, momentum;
        sb_energy energy = {0, 0, 0};
        if (!verify_suits(verify_elements + e, SB_LINEAR))
            continue;
        mesh = verify_box(verify_elements[e].type, 2, 2, 2, a, b, c);
        def = verify_def(&mesh, verify_elements + e, make(verify_materials));
        def.mass = SB_MASS_CONSISTENT;
        body = scene_body(&def);
        v = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
        for (int i = 0; i < mesh.node_count; i++)
            v[i] = sb_v3(REAL(-w) * mesh.nodes[i].y, REAL(w) * mesh.nodes[i].x, 0);
        CHECK_OK(sb_body_set_velocities(body, v));
        CHECK_OK(sb_body_energy(body, &energy));
        momentum = sb_body_momentum(body);
        verify("spinning box 2x2x2, consistent mass", verify_elements[e].name, "rho abc (a^2 + b^2) w^2/6",
               "kinetic energy (J)", density * a * b * c * (a * a + b * b) * w * w / 6, (double)energy.kinetic, exact);
        verify("spinning box 2x2x2, consistent mass", verify_elements[e].name, "rho abc w a/2", "momentum y (kg m/s)",
               density * a * b * c * w * a / 2, (double)momentum.y, exact);
        free(v);
        verify_free(body, &mesh);
    }
}

static void test_loads(void)
{
    for (int e = 0; e < VERIFY_ELEMENTS; e++) {
        static const double a = 0.9, b = 0.7, c = 0.5, g = 9.81;
        static const verify_plane left = {0, 0};
        sb_mesh mesh;
        sb_body_def def;
        sb_body *body;
        double moment = 0;
        if (!verify_suits(verify_elements + e, SB_LINEAR))
            continue;
        mesh = verify_box(verify_elements[e].type, 2, 2, 2, a, b, c);
        def = verify_def(&mesh, verify_elements + e, make(verify_materials));
        def.gravity = sb_v3(0, 0, REAL(-g));
        body = scene_body(&def);
        verify_move(body, &mesh, verify_on_plane, &left, SB_XYZ, sb_v3(0, 0, 0));
        verify_solve(body);
        for (int i = 0; i < mesh.node_count; i++) /* supports lie at x = 0: their reactions have no such moment */
            moment += (double)sb_body_external_forces(body)[i].z * (double)mesh.nodes[i].x;
        verify("weight of a box 2x2x2", verify_elements[e].name, "rho abc g", "reaction z (N)", density * a * b * c * g,
               (double)verify_reaction(body, &mesh, verify_on_plane, &left).z, exact);
        verify("weight of a box 2x2x2", verify_elements[e].name, "-rho abc g a/2", "moment of the loads (N m)",
               -density * a * b * c * g * a / 2, moment, exact);
        verify_free(body, &mesh);
    }
}

static void test_table(void) { verify_table("verification_patch"); }

CHECK_SUITE(verification_patch, {"patch tests", test_patch}, {"patch tests by tractions", test_traction_patch},
            {"rigid motion", test_rigid}, {"infinitesimal rotation", test_infinitesimal}, {"mass", test_mass},
            {"loads", test_loads}, {"table", test_table});
