/* B-bar elements, and tet4 with patches: patch tests, rank, locking, frames, derivatives, stresses, violence. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

static const double pi = 3.14159265358979323846;

enum { MODELS = 9, CORNERS = 8, DOFS = 24 };
static const sb_element_type types[] = {SB_HEX8, SB_TET10, SB_HEX20, SB_HEX27, SB_TET4};
enum { TYPES = (int)(sizeof types / sizeof types[0]) };

static sb_material model_of(int model, double poisson)
{
    const sb_real young = REAL(5e3), nu = REAL(poisson), density = REAL(1000);
    sb_material m = sb_material_linear(young, nu, density);
    switch (model) {
    case 0: return m;
    case 1: return sb_material_corotated(young, nu, density);
    case 2: return sb_material_corotated_invertible(young, nu, density);
    case 3: return sb_material_svk(young, nu, density);
    case 4: return sb_material_neo_hookean(young, nu, density);
    case 5: return sb_material_neo_hookean_isochoric(m.c10, m.d1, density);
    case 6: return sb_material_stable_neo_hookean(young, nu, density);
    case 7: return sb_material_mooney_rivlin(REAL(0.7) * m.c10, REAL(0.3) * m.c10, m.d1, density);
    default: return sb_material_reduced_polynomial(m.c10, REAL(0.1) * m.c10, REAL(0.02) * m.c10, m.d1, density);
    }
}

/* Tet4 have patches in place of mean points. */
static sb_integration integration_of(sb_element_type type)
{
    return type == SB_TET4 ? SB_INTEGRATION_PATCH : SB_INTEGRATION_BBAR;
}

static sb_body *bbar_body(const sb_mesh *mesh, sb_material material, int bbar)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = material;
    def.integration = bbar ? integration_of(mesh->element_type) : SB_INTEGRATION_AUTO;
    return scene_body(&def);
}

/* Prescribes all nodes where u says and solves: the reactions are the internal forces then. */
static sb_result hold(sb_body *body, const sb_vec3 *u)
{
    for (int i = 0; i < sb_body_node_count(body); i++)
        CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u[i], 1));
    CHECK_OK(sb_body_set_displacements(body, u));
    return sb_body_solve_static(body, NULL, NULL);
}

static sb_real energy_at(sb_body *body, const sb_vec3 *u)
{
    sb_energy energy = {0, 0, 0};
    CHECK_OK(sb_body_set_displacements(body, u));
    CHECK_OK(sb_body_energy(body, &energy));
    return energy.elastic;
}

/* ---- patch ---- */

static sb_vec3 affine(sb_vec3 x)
{
    return sb_v3(REAL(0.10) * x.x + REAL(0.04) * x.y - REAL(0.03) * x.z + REAL(0.01),
                 REAL(-0.02) * x.x - REAL(0.05) * x.y + REAL(0.06) * x.z,
                 REAL(0.05) * x.x + REAL(0.02) * x.y + REAL(0.07) * x.z - REAL(0.02));
}

static void patch(sb_element_type type, int model, double shake)
{
    int cells = type == SB_HEX8 || type == SB_TET4 ? 3 : 2;
    sb_mesh mesh = scene_box(type, cells, cells, cells, sb_v3(1, 1, 1), shake);
    sb_static_options options = sb_default_static_options();
    sb_vec3 *expected = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
    sb_body *body = bbar_body(&mesh, model_of(model, 0.3), 1), *plain = bbar_body(&mesh, model_of(model, 0.3), 0);
    sb_energy energy, plain_energy;
    scene_fix_boundary(body, &mesh);
    for (int i = 0; i < mesh.node_count; i++) {
        expected[i] = affine(mesh.nodes[i]);
        if (sb_body_supports(body)[i])
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &expected[i], 1));
    }
    options.tolerance = REAL(1e-13);
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    CHECK_NEAR(scene_distance(sb_body_displacements(body), expected, mesh.node_count), 0, scene_tolerance(1e-12, 100));
    CHECK_OK(sb_body_set_displacements(plain, expected));
    CHECK_OK(sb_body_energy(body, &energy));
    CHECK_OK(sb_body_energy(plain, &plain_energy));
    CHECK_NEAR(energy.elastic / plain_energy.elastic, 1, scene_tolerance(1e-11, 2000));
    CHECK_INT(sb_body_point_count(body), sb_body_point_count(plain));
    for (int p = 0; p < sb_body_point_count(body); p++) { /* the stress is whole at every point */
        sb_mat3 stress, whole;
        CHECK_OK(sb_body_stress(body, mesh.element_count / 2, p, &stress));
        CHECK_OK(sb_body_stress(plain, mesh.element_count / 2, p, &whole));
        CHECK_NEAR(sb_von_mises(sb_m3_sub(stress, whole)) + sb_abs(sb_m3_trace(sb_m3_sub(stress, whole))), 0,
                   scene_tolerance(1e-9, 2e4) * (double)sb_von_mises(whole));
    }
    sb_body_destroy(body);
    sb_body_destroy(plain);
    sb_mesh_free(&mesh);
    free(expected);
}

static void test_patch(void)
{
    for (int t = 0; t < TYPES; t++)
        for (int m = 0; m < MODELS; m++) {
            patch(types[t], m, 0);
            patch(types[t], m, 0.2);
        }
}

/* ---- the stiffness of one element, from energies: exact, since a linear body's energy is quadratic ---- */

static sb_vec3 unit(int axis, double length)
{
    return sb_v3(REAL(axis == 0 ? length : 0), REAL(axis == 1 ? length : 0), REAL(axis == 2 ? length : 0));
}

static void element_stiffness(const sb_mesh *mesh, double poisson, int bbar, double k[DOFS][DOFS])
{
    sb_body *body = bbar_body(mesh, model_of(0, poisson), bbar);
    double alone[DOFS];
    for (int i = 0; i < DOFS; i++)
        for (int j = i; j < DOFS; j++) {
            sb_vec3 u[CORNERS];
            memset(u, 0, sizeof u);
            u[i / 3] = unit(i % 3, 1);
            if (i == j) {
                alone[i] = k[i][i] = 2 * (double)energy_at(body, u);
                continue;
            }
            u[j / 3] = sb_v3_add(u[j / 3], unit(j % 3, 1));
            k[i][j] = (double)energy_at(body, u);
        }
    for (int i = 0; i < DOFS; i++)
        for (int j = i + 1; j < DOFS; j++)
            k[i][j] = k[j][i] = k[i][j] - 0.5 * (alone[i] + alone[j]);
    sb_body_destroy(body);
}

/* Eigenvalues by Jacobi's rotations, ascending. */
static void eigenvalues(double a[DOFS][DOFS], double values[DOFS])
{
    for (int sweep = 0; sweep < 30; sweep++)
        for (int p = 0; p < DOFS; p++)
            for (int q = p + 1; q < DOFS; q++) {
                double angle = 0.5 * atan2(2 * a[p][q], a[q][q] - a[p][p]), c = cos(angle), s = sin(angle);
                for (int i = 0; i < DOFS; i++) {
                    double x = a[i][p], y = a[i][q];
                    a[i][p] = c * x - s * y;
                    a[i][q] = s * x + c * y;
                }
                for (int i = 0; i < DOFS; i++) {
                    double x = a[p][i], y = a[q][i];
                    a[p][i] = c * x - s * y;
                    a[q][i] = s * x + c * y;
                }
            }
    for (int i = 0; i < DOFS; i++) {
        int at = i;
        for (; at > 0 && values[at - 1] > a[i][i]; at--)
            values[at] = values[at - 1];
        values[at] = a[i][i];
    }
}

static void one_element(sb_mesh *mesh, double shake)
{
    unsigned long long seed = 5;
    *mesh = scene_box(SB_HEX8, 1, 1, 1, sb_v3(1, 1, 1), 0);
    for (int i = 0; i < mesh->node_count; i++)
        mesh->nodes[i] = sb_v3_add(mesh->nodes[i], sb_v3(REAL(check_random_in(&seed, -shake, shake)),
                                                         REAL(check_random_in(&seed, -shake, shake)),
                                                         REAL(check_random_in(&seed, -shake, shake))));
}

/* Six rigid motions, eighteen that are not; and when volume becomes stiff, one mode does, not those of bending too. */
static void test_rank_and_locking_modes(void)
{
    for (int shaken = 0; shaken < 2; shaken++) {
        double k[DOFS][DOFS], values[DOFS], mu;
        int stiff[2];
        sb_mesh mesh;
        one_element(&mesh, shaken ? 0.2 : 0);
        element_stiffness(&mesh, 0.3, 1, k);
        eigenvalues(k, values);
        for (int i = 0; i < DOFS; i++) {
            if (i < 6)
                CHECK_NEAR(values[i] / values[DOFS - 1], 0, scene_tolerance(1e-13, 100));
            else
                CHECK(values[i] > 0.01 * values[DOFS - 1]);
        }
        for (int bbar = 0; bbar < 2; bbar++) {
            sb_material nearly = model_of(0, 0.4999);
            mu = (double)nearly.mu;
            element_stiffness(&mesh, 0.4999, bbar, k);
            eigenvalues(k, values);
            stiff[bbar] = 0;
            for (int i = 0; i < DOFS; i++)
                stiff[bbar] += values[i] > 20 * mu;
        }
        printf("  %s element at nu 0.4999: %d of its modes are stiff, %d with B-bar\n",
               shaken ? "distorted" : "straight", stiff[0], stiff[1]);
        CHECK_INT(stiff[1], 1);
        CHECK(stiff[0] >= 7);
        sb_mesh_free(&mesh);
    }
}

/* ---- an incompressible field with a closed form: u = curl-like, b = 3 pi^2 mu u whatever the bulk modulus ---- */

static sb_vec3 swirl(sb_vec3 p)
{
    double x = pi * (double)p.x, y = pi * (double)p.y, z = pi * (double)p.z;
    return sb_v3(REAL(0.01 * sin(x) * cos(y) * sin(z)), REAL(-0.01 * cos(x) * sin(y) * sin(z)), 0);
}

/* Root of the mean square error over the cube. */
static double swirl_error(int cells, int bbar, double poisson)
{
    sb_mesh mesh = scene_box(SB_HEX8, cells, cells, cells, sb_v3(1, 1, 1), 0);
    sb_material material = model_of(0, poisson);
    sb_body *body = bbar_body(&mesh, material, bbar);
    sb_static_options options = sb_default_static_options();
    double sum = 0, volume = 1.0 / (cells * cells * cells);
    scene_fix_boundary(body, &mesh);
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 u = swirl(mesh.nodes[i]), f = sb_v3_scale(REAL(3 * pi * pi * (double)material.mu * volume), u);
        if (sb_body_supports(body)[i])
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u, 1));
        else
            CHECK_OK(sb_body_add_forces(body, &i, 1, &f, 1));
    }
    options.tolerance = REAL(1e-8);
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 d = sb_v3_sub(sb_body_displacements(body)[i], swirl(mesh.nodes[i]));
        sum += (double)sb_v3_dot(d, d);
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return sqrt(sum * volume);
}

static void test_order_when_nearly_incompressible(void)
{
    static const double poisson[3] = {0.3, 0.499, 0.4999};
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("convergence orders need double");
        return;
    }
    for (int k = 0; k < 3; k++) {
        double coarse = swirl_error(6, 1, poisson[k]), fine = swirl_error(12, 1, poisson[k]);
        double order = log(coarse / fine) / log(2.0);
        printf("  order at nu %g: %.2f (errors %.3g %.3g)\n", poisson[k], order, coarse, fine);
        CHECK(order > 1.9);
    }
}

/* ---- Cook's membrane in plane strain ---- */

static double cook(sb_element_type type, int cells, int bbar, double poisson, int model)
{
    sb_mesh mesh = scene_box(type, cells, cells, 1, sb_v3(1, 1, REAL(1.0 / 16)), 0);
    sb_static_options options = sb_default_static_options();
    sb_material material = model_of(model, poisson);
    sb_body *body;
    double tip;
    int corner = 0, face[SB_MAX_FACE_NODES];
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 *x = mesh.nodes + i;
        x->y = REAL(0.44) * x->x + x->y * (REAL(0.44) - REAL(0.28) * x->x);
        x->x *= REAL(0.48);
    }
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].x + mesh.nodes[i].y > mesh.nodes[corner].x + mesh.nodes[corner].y)
            corner = i;
    body = bbar_body(&mesh, material, bbar);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int i = 0; i < mesh.node_count; i++)
        CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_Z));
    for (int e = 0; e < mesh.element_count; e++)
        for (int f = 0; f < sb_element_face_count(type); f++) {
            sb_element_type face_type;
            int nodes[4], at_end = 1, corners;
            sb_element_face(type, f, face, &face_type);
            corners = sb_element_corner_count(face_type);
            for (int k = 0; k < corners; k++) {
                nodes[k] = mesh.elements[e * sb_element_node_count(type) + face[k]];
                at_end &= mesh.nodes[nodes[k]].x > REAL(0.4799);
            }
            if (at_end)
                CHECK_OK(sb_body_add_traction(body, nodes, 1, corners, sb_v3(0, REAL(model ? 200 : 20), 0), NULL));
        }
    options.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-4 : 1e-8);
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    tip = (double)sb_body_displacements(body)[corner].y;
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return tip;
}

static void test_cook(void)
{
    /* of 40 x 40 B-bar cells; 16 x 16 cells of tet10, which still stiffen a little, are within 4 % of it */
    static const double reference[2][2] = {{0.012335, 0.012321}, {0.097821, 0.097754}};
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("systems of nearly incompressible bodies need double");
        return;
    }
    for (int m = 0; m < 2; m++)
        for (int k = 0; k < 2; k++) {
            double nu = k ? 0.4999 : 0.499, expected = reference[m][k];
            double bbar = cook(SB_HEX8, 12, 1, nu, 4 * m), plain = cook(SB_HEX8, 12, 0, nu, 4 * m);
            printf("  Cook, model %d, nu %g: B-bar %.5f, hex8 %.5f, expected %.5f m\n", 4 * m, nu, bbar, plain,
                   expected);
            CHECK_NEAR(bbar / expected, 1, 0.04);
            CHECK(plain < 0.5 * expected); /* the plain one locks, or this tests nothing */
        }
}

/* ---- frames and derivatives ---- */

/* Some displacement that inverts nothing. */
static sb_vec3 *wobble(const sb_mesh *mesh, double size)
{
    sb_vec3 *u = (sb_vec3 *)malloc((size_t)mesh->node_count * sizeof(sb_vec3));
    unsigned long long seed = 17;
    for (int i = 0; i < mesh->node_count; i++)
        u[i] = sb_v3(REAL(check_random_in(&seed, -size, size)), REAL(check_random_in(&seed, -size, size)),
                     REAL(check_random_in(&seed, -size, size)));
    return u;
}

static void rotation(sb_element_type type)
{
    sb_mesh mesh = scene_box(type, 2, 2, 2, sb_v3(1, 1, 1), 0.2);
    sb_vec3 *u = wobble(&mesh, 0.06), *turned = wobble(&mesh, 0);
    sb_mat3 r = sb_quat_to_mat3(sb_quat_from_rotation_vector(sb_v3(REAL(0.7), REAL(-1.1), REAL(0.4))));
    for (int i = 0; i < mesh.node_count; i++)
        turned[i] = sb_v3_sub(sb_m3_apply(r, sb_v3_add(mesh.nodes[i], u[i])), mesh.nodes[i]);
    for (int m = 1; m < MODELS; m++) { /* a linear body takes rotation for strain */
        sb_body *body = bbar_body(&mesh, model_of(m, 0.45), 1);
        sb_mat3 here, there;
        double before = (double)energy_at(body, u), after;
        int last = sb_body_point_count(body) - 1;
        CHECK_OK(sb_body_stress(body, 3, last, &here));
        after = (double)energy_at(body, turned);
        CHECK_NEAR(after / before, 1, scene_tolerance(1e-12, 1000));
        CHECK_OK(sb_body_stress(body, 3, last, &there));
        here = sb_m3_mult(sb_m3_mul(r, here), r);
        CHECK_NEAR(sb_von_mises(sb_m3_sub(here, there)) / sb_von_mises(here), 0, scene_tolerance(1e-11, 2e4));
        sb_body_destroy(body);
    }
    sb_mesh_free(&mesh);
    free(u);
    free(turned);
}

static void test_rotation(void)
{
    for (int t = 0; t < TYPES; t++)
        rotation(types[t]);
}

/* Force = derivative of the energy, by central differences along a random direction. */
static void derivative(sb_element_type type)
{
    sb_mesh mesh = scene_box(type, 2, 2, 2, sb_v3(1, 1, 1), 0.2);
    sb_vec3 *u = wobble(&mesh, 0.06), *direction = wobble(&mesh, 1), *moved = wobble(&mesh, 0);
    const double h = SB_REAL_IS_FLOAT ? 2e-3 : 1e-5;
    for (int m = 0; m < MODELS; m++) {
        sb_body *body = bbar_body(&mesh, model_of(m, 0.45), 1);
        double sides[2], work = 0, slope;
        CHECK_OK(hold(body, u));
        for (int i = 0; i < mesh.node_count; i++)
            work += (double)sb_v3_dot(sb_body_reactions(body)[i], direction[i]);
        for (int side = 0; side < 2; side++) {
            for (int i = 0; i < mesh.node_count; i++)
                moved[i] = sb_v3_madd(u[i], REAL(side ? h : -h), direction[i]);
            sides[side] = (double)energy_at(body, moved);
        }
        slope = (sides[1] - sides[0]) / (2 * h);
        CHECK_NEAR(slope / work, 1, SB_REAL_IS_FLOAT ? 1e-2 : 1e-6);
        sb_body_destroy(body);
    }
    sb_mesh_free(&mesh);
    free(u);
    free(direction);
    free(moved);
}

static void test_force_is_the_energys_derivative(void)
{
    for (int t = 0; t < TYPES; t++)
        derivative(types[t]);
}

/* A wrong or unsymmetric tangent would cost iterations: they are counted, from rest and for a little more load. */
static void newton(sb_element_type type)
{
    int cells = type == SB_HEX8 || type == SB_TET10 || type == SB_TET4 ? 2 : 1;
    sb_mesh mesh = scene_box(type, 4 * cells, cells, cells, sb_v3(REAL(0.1), REAL(0.02), REAL(0.02)), 0.1);
    for (int m = 1; m < MODELS; m++) {
        sb_static_options options = sb_default_static_options();
        sb_step_info info, more;
        sb_body *body = bbar_body(&mesh, model_of(m, 0.49), 1);
        CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, -1)));
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        options.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-4 : 1e-10);
        if (!CHECK_OK(sb_body_solve_static(body, &options, &info)))
            printf("%s\n", info.error.message);
        CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, REAL(-1.01))));
        CHECK_OK(sb_body_solve_static(body, &options, &more));
        printf("  bending, %s, model %d: %d Newton, %d more for 1 %% more load, tip %.4f m\n", sb_element_name(type), m,
               info.newton_iterations, more.newton_iterations,
               (double)sb_body_displacements(body)[mesh.node_count - 1].z);
        CHECK(info.newton_iterations <= (type == SB_HEX8 ? 25 : 30));
        CHECK(more.newton_iterations <= (SB_REAL_IS_FLOAT && type != SB_HEX8 ? 8 : 5));
        sb_body_destroy(body);
    }
    sb_mesh_free(&mesh);
}

static void test_newton(void)
{
    for (int t = 0; t < TYPES; t++)
        newton(types[t]);
}

/* ---- large strain, nearly incompressible: a block twisted by a right angle keeps its volume ---- */

/* Volume of a hex8 with corners at x. */
static double hex_volume(const sb_vec3 *x)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS], gradient[CORNERS][3], sum = 0;
    int q = sb_element_quadrature(SB_HEX8, SB_QUADRATURE_STIFFNESS, points, weights);
    for (int p = 0; p < q; p++) {
        sb_vec3 columns[3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
        sb_element_shape(SB_HEX8, points[p], NULL, gradient);
        for (int a = 0; a < CORNERS; a++)
            for (int j = 0; j < 3; j++)
                columns[j] = sb_v3_madd(columns[j], gradient[a][j], x[a]);
        sum += weights[p] * sb_m3_det(sb_m3_columns(columns[0], columns[1], columns[2]));
    }
    return (double)sum;
}

static void test_twist_keeps_volume(void)
{
    sb_mesh mesh = scene_box(SB_HEX8, 3, 3, 6, sb_v3(1, 1, 2), 0);
    sb_static_options options = sb_default_static_options();
    sb_body *body = bbar_body(&mesh, model_of(4, SB_REAL_IS_FLOAT ? 0.49 : 0.4999), 1);
    sb_step_info info;
    double least = 10, most = 0;
    scene_fix_plane(body, &mesh, 2, 0, SB_XYZ);
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].z > REAL(1.999)) {
            sb_vec3 x = mesh.nodes[i], to = sb_v3(1 - x.y - x.x, x.x - x.y, 0);
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &to, 1));
        }
    options.load_steps = 6;
    options.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-4 : 1e-8);
    if (!CHECK_OK(sb_body_solve_static(body, &options, &info)))
        printf("%s\n", info.error.message);
    for (int e = 0; e < mesh.element_count; e++) {
        sb_vec3 before[CORNERS], after[CORNERS];
        double growth;
        for (int a = 0; a < CORNERS; a++) {
            before[a] = mesh.nodes[mesh.elements[8 * e + a]];
            after[a] = sb_body_positions(body)[mesh.elements[8 * e + a]];
        }
        growth = hex_volume(after) / hex_volume(before);
        least = fmin(least, growth);
        most = fmax(most, growth);
    }
    printf("  twist by 90 degrees: volumes change by %.2g to %.2g\n", least - 1, most - 1);
    CHECK(least > 0.99 &&
          most < 1.01); /* det of the mean F is kept, and differs from that by the twist within a cell */
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- violence ---- */

/* Thrown about, squeezed flat, dragged: it stays finite, fails no step and comes back to its shape. */
static void beat(sb_element_type type, int model, unsigned long long seed)
{
    int cells = type == SB_HEX8 || type == SB_TET4 ? 2 : 1;
    sb_mesh mesh = scene_box(type, 3, cells, cells, sb_v3(REAL(0.15), REAL(0.1), REAL(0.1)), 0.1);
    sb_body_def def = sb_default_body_def();
    int n = mesh.node_count, failures = 0, tool = n / 2;
    sb_vec3 *u = (sb_vec3 *)malloc((size_t)n * sizeof(sb_vec3));
    sb_body *body;
    def.mesh = &mesh;
    def.material = model_of(model, 0.45);
    def.integration = integration_of(type);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.damping_stiffness = REAL(0.01);
    def.tolerance = REAL(1e-2);
    def.max_iterations = 60;
    def.newton_tolerance = REAL(1e-3);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int s = 0; s < 400; s++) {
        if (s % 80 == 20)
            for (int i = 0; i < n; i++) {
                u[i] = sb_body_displacements(body)[i];
                if (!sb_body_supports(body)[i] && check_random(&seed) < 0.1)
                    u[i] = sb_v3(REAL(check_random_in(&seed, -0.3, 0.3)), REAL(check_random_in(&seed, -0.3, 0.3)),
                                 REAL(check_random_in(&seed, -0.3, 0.3)));
                else if (!sb_body_supports(body)[i] && s % 160 == 100)
                    u[i].z = REAL(0.05) - mesh.nodes[i].z;
            }
        if (s % 80 == 20)
            CHECK_OK(sb_body_set_displacements(body, u));
        if (s % 80 == 60) {
            sb_vec3 to = sb_v3(REAL(check_random_in(&seed, -0.3, 0.3)), 0, REAL(0.2));
            CHECK_OK(sb_body_prescribe(body, &tool, 1, SB_XYZ, &to, 1));
        }
        if (s % 80 == 70)
            CHECK_OK(sb_body_release_nodes(body, &tool, 1, SB_XYZ));
        failures += sb_body_step(body, REAL(1.0 / 60), NULL) != SB_OK;
        if (!CHECK(scene_all_finite(sb_body_positions(body), n)))
            break;
    }
    CHECK_OK(sb_body_release_nodes(body, &tool, 1, SB_XYZ));
    CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, 0)));
    CHECK_OK(sb_body_set_solver(body, REAL(1e-4), 500));
    for (int s = 0; s < 700; s++)
        failures += sb_body_step(body, REAL(1.0 / 60), NULL) != SB_OK;
    printf("  violence, %s, model %d: %d steps undone, %.2g m from rest at the end\n", sb_element_name(type), model,
           failures, scene_distance(sb_body_positions(body), mesh.nodes, n));
    CHECK_NEAR(scene_distance(sb_body_positions(body), mesh.nodes, n), 0, 2e-4);
    CHECK_INT(failures, 0);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(u);
}

static void test_violence(void)
{
    for (unsigned long long seed = 23, end = seed + (unsigned long long)check_rounds(2); seed < end; seed++)
        for (int t = 0; t < (seed > 23 ? 1 : TYPES); t++) {
            beat(types[t], 1, seed);
            beat(types[t], 2, seed);
            beat(types[t], 6, seed);
        }
}

/* ---- set-up ---- */

/* The four mean points of a hex27 have its volume; values at them that are linear are met anywhere. A tet10 has a mean
 * point or one rotation. */
static void setup_of_four(void)
{
    sb_mesh hex = scene_box(SB_HEX27, 2, 1, 1, sb_v3(1, 1, 1), 0.2),
            tet = scene_box(SB_TET10, 1, 1, 1, sb_v3(1, 1, 1), 0);
    sb_domain domain;
    sb_error error;
    CHECK_OK(sb_domain_create(&hex, SB_INTEGRATION_BBAR, 0, NULL, &domain, NULL));
    CHECK_INT(domain.points_per_cell, 31);
    CHECK_INT(domain.mean_points, 4);
    for (int e = 0; e < 2; e++) {
        sb_real ordinary = 0, means = 0;
        for (int p = 0; p < 31; p++) {
            *(p < 27 ? &ordinary : &means) += domain.weights[31 * e + p];
            CHECK(domain.weights[31 * e + p] > 0);
        }
        CHECK_NEAR(means / ordinary, 1, scene_tolerance(1e-14, 10));
    }
    sb_domain_free(&domain);
    CHECK_RESULT(sb_domain_create(&tet, SB_INTEGRATION_BBAR, 1, NULL, &domain, &error), SB_ERROR_ARGUMENT);
    CHECK_OK(sb_domain_create(&tet, SB_INTEGRATION_BBAR, 0, NULL, &domain, NULL));
    CHECK_INT(domain.points_per_cell, 5);
    sb_domain_free(&domain);
    sb_mesh_free(&hex);
    sb_mesh_free(&tet);
}

static void test_setup(void)
{
    sb_mesh hex = scene_box(SB_HEX8, 2, 2, 2, sb_v3(1, 1, 1), 0), tet = scene_box(SB_TET4, 2, 2, 2, sb_v3(1, 1, 1), 0);
    sb_body_def def = sb_default_body_def();
    sb_check_report report;
    sb_body *body = NULL;
    sb_domain domain;
    sb_error error;
    sb_real sum = 0;
    def.mesh = &tet;
    def.material = model_of(1, 0.3);
    def.integration = SB_INTEGRATION_BBAR;
    CHECK_RESULT(sb_body_create(&def, &body, &error), SB_ERROR_ARGUMENT);
    CHECK(body == NULL && strstr(error.message, "has tet4") != NULL);
    CHECK_OK(sb_domain_create(&hex, SB_INTEGRATION_BBAR, 0, NULL, &domain, NULL));
    CHECK_INT(domain.points_per_cell, 9);
    CHECK_INT(domain.mean_points, 1);
    for (int p = 0; p < 8; p++)
        sum += domain.weights[p];
    CHECK_NEAR(sum, domain.weights[8], scene_tolerance(1e-15, 4));
    sb_domain_free(&domain);
    setup_of_four();
    for (int bbar = 0; bbar < 2; bbar++) {
        body = bbar_body(&hex, model_of(1, 0.495), bbar);
        CHECK_OK(sb_body_check(body, &report));
        CHECK_INT(report.warnings & SB_CHECK_LOCKING, bbar ? 0 : SB_CHECK_LOCKING);
        CHECK_NEAR(sb_body_mass(body), 1000, scene_tolerance(1e-9, 1e5));
        CHECK_RESULT(sb_body_stress(body, 0, 8, NULL), SB_ERROR_ARGUMENT);
        sb_body_destroy(body);
    }
    body = bbar_body(&hex, model_of(1, 0.495), 1);
    if (body) {
        sb_mat3 stress;
        CHECK_RESULT(sb_body_stress(body, 0, 8, &stress), SB_ERROR_INDEX);
    }
    sb_body_destroy(body);
    sb_mesh_free(&hex);
    sb_mesh_free(&tet);
}

static unsigned long long play(int workers)
{
    sb_mesh mesh = scene_box(SB_HEX8, 6, 5, 5, sb_v3(REAL(0.2), REAL(0.1), REAL(0.1)), 0.1);
    sb_body_def def = sb_default_body_def();
    unsigned long long hash;
    sb_body *body;
    def.mesh = &mesh;
    def.material = model_of(4, 0.49);
    def.integration = SB_INTEGRATION_BBAR;
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.jobs = scene_jobs(&workers);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int s = 0; s < 4; s++)
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    hash = scene_hash(sb_body_displacements(body), (size_t)mesh.node_count * sizeof(sb_vec3));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return hash;
}

static void test_threads(void)
{
    unsigned long long expected = play(1);
    CHECK(play(2) == expected);
    CHECK(play(7) == expected);
}

CHECK_SUITE(bbar, {"patch", test_patch}, {"rank and stiff modes", test_rank_and_locking_modes},
            {"order when nearly incompressible", test_order_when_nearly_incompressible}, {"Cook's membrane", test_cook},
            {"rotation", test_rotation}, {"force is the energy's derivative", test_force_is_the_energys_derivative},
            {"Newton", test_newton}, {"twist keeps volume", test_twist_keeps_volume}, {"violence", test_violence},
            {"set-up", test_setup}, {"threads", test_threads});
