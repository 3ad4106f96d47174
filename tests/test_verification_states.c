/* Homogeneous states of every material in a body of every element, against closed forms in principal
 * stretches and in simple shear; the same with fibres along, across and at an angle.
 *
 * The body is a unit cube with a distorted inside: its reactions are stresses on faces of area 1, its energy
 * is W. The expected values come from the formulas of verification_scene.h, not from the library. */
#include "verification_scene.h"

static const double young = 5e3, poisson = 0.4, bound = 1e-8;

/* The principal stretches that are prescribed; along the others the cube is free: stress 0. */
typedef struct state {
    const char *name;
    const char *source;
    double stretch[3]; /* 0: free */
} state;

static const state states[] = {
    {"uniaxial tension 1.5", "Ogden 1997, P_2 = P_3 = 0", {1.5, 0, 0}},
    {"uniaxial compression 0.7", "Ogden 1997, P_2 = P_3 = 0", {0.7, 0, 0}},
    {"equibiaxial tension 1.25", "Ogden 1997, P_3 = 0", {1.25, 1.25, 0}},
    {"pure shear 1.4", "Treloar 1975, l_2 = 1, P_3 = 0", {1.4, 1, 0}},
    {"hydrostatic tension 1.1", "P = dW/dl at l_1 = l_2 = l_3", {1.1, 1.1, 1.1}},
    /* no more: under 0.95 svk has lost its ellipticity, S + mu l^2 < 0, and buckles inside */
    {"hydrostatic compression 0.97", "P = dW/dl at l_1 = l_2 = l_3", {0.97, 0.97, 0.97}}};
enum { STATES = (int)(sizeof states / sizeof states[0]) };

/* ---- the closed form ---- */

typedef struct lateral {
    const verify_material *material;
    const state *held;
} lateral;

static void stretches_at(const state *s, double q, double l[3])
{
    for (int i = 0; i < 3; i++)
        l[i] = s->stretch[i] > 0 ? s->stretch[i] : q;
}

/* Stress along the last axis when all free axes have the stretch q. */
static double lateral_stress(const void *user, double q)
{
    const lateral *c = (const lateral *)user;
    double l[3], stress[3];
    stretches_at(c->held, q, l);
    c->material->principal(verify_constants_of(young, poisson), l, stress);
    return stress[2];
}

/* ---- the body ---- */

static verify_plane face_of(int axis, double value)
{
    verify_plane plane;
    plane.axis = axis;
    plane.value = value;
    return plane;
}

static sb_mesh distorted_cube(const verify_element *element)
{
    static const double amplitude = 0.05;
    return verify_block(element->type, 2, 2, 2, verify_map_distorted, &amplitude, 1);
}

/* Largest difference between the displacements and x -> (G - I) x (G row by row). */
static double displacement_error(const sb_body *body, const sb_mesh *mesh, const double G[9])
{
    double worst = 0;
    for (int i = 0; i < mesh->node_count; i++) {
        sb_vec3 x = mesh->nodes[i], now = sb_body_positions(body)[i];
        const double at[3] = {(double)x.x, (double)x.y, (double)x.z};
        const double found[3] = {(double)now.x, (double)now.y, (double)now.z};
        for (int r = 0; r < 3; r++)
            worst =
                verify_worse(worst, fabs(found[r] - G[3 * r] * at[0] - G[3 * r + 1] * at[1] - G[3 * r + 2] * at[2]));
    }
    return worst;
}

/* Solves one state; the cube's faces through the origin are on rollers. Checks displacements and energy, and
 * returns the reaction along axis 0. */
static double solve_state(const verify_element *element, sb_material material, const state *s, const double l[3],
                          double energy)
{
    const double G[9] = {l[0], 0, 0, 0, l[1], 0, 0, 0, l[2]};
    sb_mesh mesh = distorted_cube(element);
    sb_body *body = verify_body(&mesh, element, material);
    sb_energy found;
    double force;
    for (int axis = 0; axis < 3; axis++) {
        sb_real pull = REAL(s->stretch[axis] - 1);
        verify_plane end = face_of(axis, 1);
        scene_fix_plane(body, &mesh, axis, 0, 1 << axis);
        if (s->stretch[axis] > 0)
            verify_move(body, &mesh, verify_on_plane, &end, 1 << axis, sb_v3(pull, pull, pull));
    }
    verify_solve(body);
    CHECK_NEAR(displacement_error(body, &mesh, G), 0, scene_tolerance(bound, 1e3));
    CHECK_OK(sb_body_energy(body, &found));
    CHECK_NEAR(found.elastic, energy, scene_tolerance(bound, 1e4) * energy);
    verify_plane end = face_of(0, 1);
    force = (double)verify_reaction(body, &mesh, verify_on_plane, &end).x;
    verify_free(body, &mesh);
    return force;
}

/* Every element must find the same; the row shows the one that is farthest off. */
static void verify_state(const verify_material *material, const state *s)
{
    lateral free_sides;
    sb_material made = material->make(REAL(young), REAL(poisson), REAL(1000));
    double q, l[3], stress[3], energy, worst = 0;
    free_sides.material = material;
    free_sides.held = s;
    q = s->stretch[2] > 0 ? 1 : verify_root(lateral_stress, &free_sides, 0.3, 2);
    stretches_at(s, q, l);
    energy = material->principal(verify_constants_of(young, poisson), l, stress);
    for (int e = 0; e < VERIFY_ELEMENTS; e++) {
        if (!verify_suits(verify_elements + e, made.model))
            continue;
        double force = solve_state(verify_elements + e, made, s, l, energy);
        if (e == 0 || fabs(force - stress[0]) > fabs(worst - stress[0]))
            worst = force;
    }
    verify(s->name, material->name, s->source, "force on a face of 1 m^2 (N); shape, W too", stress[0], worst, bound);
}

static void test_principal(void)
{
    for (int m = 0; m < VERIFY_MATERIALS; m++)
        for (int s = 0; s < STATES; s++)
            verify_state(verify_materials + m, states + s);
}

/* ---- simple shear ---- */

/* The surface is moved, the inside is free. The mean of P is the sum of f (x) X over the forces at the
 * surface. Frees body and mesh. */
static void shear_body(sb_body *body, sb_mesh *mesh, double g, double stress[2])
{
    const double G[9] = {1, g, 0, 0, 1, 0, 0, 0, 1};
    stress[0] = stress[1] = 0;
    scene_fix_boundary(body, mesh);
    for (int i = 0; i < mesh->node_count; i++) {
        sb_vec3 u = sb_v3(REAL(g) * mesh->nodes[i].y, 0, 0);
        if (sb_body_supports(body)[i])
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u, 1));
    }
    verify_solve(body);
    CHECK_NEAR(displacement_error(body, mesh, G), 0, scene_tolerance(bound, 1e3));
    for (int i = 0; i < mesh->node_count; i++) {
        stress[0] += (double)sb_body_reactions(body)[i].x * (double)mesh->nodes[i].y;
        stress[1] += (double)sb_body_reactions(body)[i].y * (double)mesh->nodes[i].y;
    }
    verify_free(body, mesh);
}

static void test_simple_shear(void)
{
    static const double g = 0.5;
    double mu = verify_constants_of(young, poisson).mu;
    for (int m = 0; m < VERIFY_MATERIALS; m++) {
        const verify_material *material = verify_materials + m;
        sb_material made = material->make(REAL(young), REAL(poisson), REAL(1000));
        double expected[2], worst[2] = {0, 0};
        material->shear(verify_constants_of(young, poisson), g, expected);
        for (int e = 0; e < VERIFY_ELEMENTS; e++) {
            double found[2];
            sb_mesh mesh;
            if (!verify_suits(verify_elements + e, made.model))
                continue;
            mesh = distorted_cube(verify_elements + e);
            shear_body(verify_body(&mesh, verify_elements + e, made), &mesh, g, found);
            for (int k = 0; k < 2; k++)
                if (e == 0 || fabs(found[k] - expected[k]) > fabs(worst[k] - expected[k]))
                    worst[k] = found[k];
        }
        verify("simple shear 0.5", material->name, "P of F = I + g e1 (x) e2", "P_12 (Pa)", expected[0], worst[0],
               bound);
        verify("simple shear 0.5", material->name, "P of F = I + g e1 (x) e2; Poynting effect", "P_22/mu",
               expected[1] / mu, worst[1] / mu, bound);
    }
}

/* ---- fibres ---- */

/* The matrix is one of these; k1 and k2 are of its size, so that both carry. */
static const double fibre_k1 = 1500, fibre_k2 = 0.8;

static const verify_material *const fibre_matrices[] = {verify_materials + 4, verify_materials + 5,
                                                        verify_materials + 7};
enum { FIBRE_MATRICES = (int)(sizeof fibre_matrices / sizeof fibre_matrices[0]) };

/* dW/dI4 (Pa) of W = k1/(2 k2) (exp(k2 (I4 - 1)^2) - 1), and W (J/m^3) itself. */
static double fibre_law(double i4, double *energy)
{
    double e = i4 > 1 ? i4 - 1 : 0, growth = exp(fibre_k2 * e * e);
    *energy = fibre_k1 / (2 * fibre_k2) * (growth - 1);
    return fibre_k1 * e * growth;
}

/* Stress at principal stretches l with fibres along the first of them. */
static double fibre_principal(const verify_material *matrix, const double l[3], double stress[3])
{
    double energy, slope = fibre_law(l[0] * l[0], &energy);
    energy += matrix->principal(verify_constants_of(young, poisson), l, stress);
    stress[0] += 2 * slope * l[0];
    return energy;
}

typedef struct fibre_state {
    const verify_material *matrix;
    double l[3];
    int held; /* the axis whose stretch is given; the others are free */
} fibre_state;

/* Stress on the third axis. */
static double fibre_third(const void *user, double third)
{
    fibre_state s = *(const fibre_state *)user;
    double stress[3];
    s.l[2] = third;
    fibre_principal(s.matrix, s.l, stress);
    return stress[2];
}

/* Stress on the free axis of the first two, when the third is free of stress. */
static double fibre_free(const void *user, double stretch)
{
    fibre_state s = *(const fibre_state *)user;
    double stress[3];
    s.l[1 - s.held] = stretch;
    s.l[2] = verify_root(fibre_third, &s, 0.5, 2);
    fibre_principal(s.matrix, s.l, stress);
    return stress[1 - s.held];
}

static sb_body *fibre_body(const sb_mesh *mesh, const verify_element *element, const verify_material *matrix, double x,
                           double y)
{
    sb_body_def def = verify_def(
        mesh, element,
        sb_material_with_fibres(matrix->make(REAL(young), REAL(poisson), REAL(1000)), REAL(fibre_k1), REAL(fibre_k2)));
    sb_vec3 *fibres = (sb_vec3 *)malloc((size_t)mesh->element_count * sizeof(sb_vec3));
    sb_body *body;
    for (int e = 0; e < mesh->element_count; e++)
        fibres[e] = sb_v3(REAL(x), REAL(y), 0);
    def.fibres = fibres;
    body = scene_body(&def);
    free(fibres);
    return body;
}

/* One axis is stretched, the others are free; returns the force along it and checks shape and energy. */
static double pull_fibres(const verify_element *element, const fibre_state *s)
{
    const double G[9] = {s->l[0], 0, 0, 0, s->l[1], 0, 0, 0, s->l[2]};
    sb_mesh mesh = distorted_cube(element);
    sb_body *body = fibre_body(&mesh, element, s->matrix, 3, 0); /* of any length */
    sb_real pull = REAL(s->l[s->held] - 1);
    verify_plane end = face_of(s->held, 1);
    sb_energy found;
    double stress[3], energy = fibre_principal(s->matrix, s->l, stress), force;
    for (int axis = 0; axis < 3; axis++)
        scene_fix_plane(body, &mesh, axis, 0, 1 << axis);
    verify_move(body, &mesh, verify_on_plane, &end, 1 << s->held, sb_v3(pull, pull, pull));
    verify_solve(body);
    CHECK_NEAR(displacement_error(body, &mesh, G), 0, scene_tolerance(bound, 1e3));
    CHECK_OK(sb_body_energy(body, &found));
    CHECK_NEAR(found.elastic, energy, scene_tolerance(bound, 1e4) * energy);
    force = (double)scene_component(verify_reaction(body, &mesh, verify_on_plane, &end), s->held);
    verify_free(body, &mesh);
    return force;
}

static void fibre_case(const char *name, const verify_material *matrix, int held, double stretch)
{
    fibre_state s;
    double expected[3], worst = 0;
    s.matrix = matrix;
    s.held = held;
    s.l[held] = stretch;
    s.l[1 - held] = verify_root(fibre_free, &s, 0.6, 1.6);
    s.l[2] = verify_root(fibre_third, &s, 0.5, 2);
    fibre_principal(matrix, s.l, expected);
    for (int e = 0; e < VERIFY_ELEMENTS; e++)
        if (verify_suits(verify_elements + e, SB_NEO_HOOKEAN)) {
            double force = pull_fibres(verify_elements + e, &s);
            if (e == 0 || fabs(force - expected[held]) > fabs(worst - expected[held]))
                worst = force;
        }
    verify(name, matrix->name, "Holzapfel, Gasser and Ogden 2000: P_1 += 2 W'(I4) l_1, the other axes free",
           "force on a face of 1 m^2 (N); shape, W too", expected[held], worst, bound);
}

static void test_fibres(void)
{
    for (int m = 0; m < FIBRE_MATRICES; m++) {
        fibre_case("fibres, stretch 1.4 along them", fibre_matrices[m], 0, 1.4);
        fibre_case("fibres, stretch 0.8 along them, slack", fibre_matrices[m], 0, 0.8);
        fibre_case("fibres, stretch 1.4 across them, slack", fibre_matrices[m], 1, 1.4);
        fibre_case("fibres, stretch 0.7 across them", fibre_matrices[m], 1, 0.7);
    }
}

/* Fibres at 30 degrees to the direction of a simple shear: P += 2 W'(I4) (F a) (x) a. */
static void test_fibre_shear(void)
{
    static const double g = 0.5;
    double c = cos(VERIFY_PI / 6), s = sin(VERIFY_PI / 6), moved = c + g * s, energy;
    double slope = fibre_law(moved * moved + s * s, &energy);
    for (int m = 0; m < FIBRE_MATRICES; m++) {
        const verify_material *matrix = fibre_matrices[m];
        double expected[2], worst[2] = {0, 0};
        matrix->shear(verify_constants_of(young, poisson), g, expected);
        expected[0] += 2 * slope * moved * s;
        expected[1] += 2 * slope * s * s;
        for (int e = 0; e < VERIFY_ELEMENTS; e++) {
            double found[2];
            sb_mesh mesh;
            if (!verify_suits(verify_elements + e, SB_NEO_HOOKEAN))
                continue;
            mesh = distorted_cube(verify_elements + e);
            shear_body(fibre_body(&mesh, verify_elements + e, matrix, c, s), &mesh, g, found);
            for (int k = 0; k < 2; k++)
                if (e == 0 || fabs(found[k] - expected[k]) > fabs(worst[k] - expected[k]))
                    worst[k] = found[k];
        }
        verify("fibres at 30 degrees, simple shear 0.5", matrix->name, "P += 2 W'(I4) (F a) (x) a", "P_12 (Pa)",
               expected[0], worst[0], bound);
        verify("fibres at 30 degrees, simple shear 0.5", matrix->name, "P += 2 W'(I4) (F a) (x) a", "P_22 (Pa)",
               expected[1], worst[1], bound);
    }
}

static void test_table(void) { verify_table("verification_states"); }

CHECK_SUITE(verification_states, {"principal stretches", test_principal}, {"simple shear", test_simple_shear},
            {"fibres", test_fibres}, {"fibres in shear", test_fibre_shear}, {"table", test_table});
