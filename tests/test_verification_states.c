/* Homogeneous states of every material in a body of every element, against closed forms in principal
 * stretches.
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
            worst = verify_worse(
                worst, fabs(found[r] - G[3 * r] * at[0] - G[3 * r + 1] * at[1] - G[3 * r + 2] * at[2]));
    }
    return worst;
}

/* Solves one state; the cube's faces through the origin are on rollers. Checks displacements and energy, and
 * returns the reaction along axis 0. */
static double solve_state(const verify_element *element, sb_material material, const state *s,
                          const double l[3], double energy)
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
    verify(s->name, material->name, s->source, "force on a face of 1 m^2 (N); shape, W too", stress[0], worst,
           bound);
}

static void test_principal(void)
{
    for (int m = 0; m < VERIFY_MATERIALS; m++)
        for (int s = 0; s < STATES; s++)
            verify_state(verify_materials + m, states + s);
}

/* ---- simple shear ---- */

/* The surface is moved, the inside is free. The mean of P is the sum of f (x) X over the forces at the
 * surface. */
static void solve_shear(const verify_element *element, sb_material material, double g, double stress[2])
{
    const double G[9] = {1, g, 0, 0, 1, 0, 0, 0, 1};
    sb_mesh mesh = distorted_cube(element);
    sb_body *body = verify_body(&mesh, element, material);
    stress[0] = stress[1] = 0;
    scene_fix_boundary(body, &mesh);
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 u = sb_v3(REAL(g) * mesh.nodes[i].y, 0, 0);
        if (sb_body_supports(body)[i])
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u, 1));
    }
    verify_solve(body);
    CHECK_NEAR(displacement_error(body, &mesh, G), 0, scene_tolerance(bound, 1e3));
    for (int i = 0; i < mesh.node_count; i++) {
        stress[0] += (double)sb_body_reactions(body)[i].x * (double)mesh.nodes[i].y;
        stress[1] += (double)sb_body_reactions(body)[i].y * (double)mesh.nodes[i].y;
    }
    verify_free(body, &mesh);
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
            if (!verify_suits(verify_elements + e, made.model))
                continue;
            solve_shear(verify_elements + e, made, g, found);
            for (int k = 0; k < 2; k++)
                if (e == 0 || fabs(found[k] - expected[k]) > fabs(worst[k] - expected[k]))
                    worst[k] = found[k];
        }
        verify("simple shear 0.5", material->name, "P of F = I + g e1 (x) e2", "P_12 (Pa)", expected[0],
               worst[0], bound);
        verify("simple shear 0.5", material->name, "P of F = I + g e1 (x) e2; Poynting effect", "P_22/mu",
               expected[1] / mu, worst[1] / mu, bound);
    }
}

static void test_table(void) { verify_table("verification_states"); }

CHECK_SUITE(verification_states, {"principal stretches", test_principal}, {"simple shear", test_simple_shear},
            {"table", test_table});
