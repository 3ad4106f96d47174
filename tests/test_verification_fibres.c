/* Fibres: strips of artery with two dispersed families pulled along and across, and a muscle that contracts, against
 * closed forms whose free sides are found by Newton. Motions are affine, so that meshes of any shape are exact. */
#include "verification_scene.h"

/* Constants of the size of an iliac artery's adventitia: c 7.64 kPa, k1 996.6 kPa, k2 524.6, kappa 0.226, families
 * at +-49.98 degrees from the circumference. */
typedef struct artery {
    double c, k1, k2, kappa, angle, bulk;
} artery;
static const artery adventitia = {7.64e3, 996.6e3, 524.6, 0.226, 49.98 * VERIFY_PI / 180, 1e6};

/* First Piola-Kirchhoff stresses (Pa) at stretches l along axes between which the families lie alike:
 * c/2 (J^(-2/3) I1 - 3) + K/2 (J - 1)^2 + 2 k1/(2 k2) (exp(k2 E^2) - 1), E = kappa I1 + (1 - 3 kappa) I4 - 1. */
static void artery_stress(const artery *a, const double l[3], double stress[3])
{
    double cosine = cos(a->angle) * cos(a->angle), squares = l[0] * l[0] + l[1] * l[1] + l[2] * l[2];
    double I4 = l[0] * l[0] * cosine + l[1] * l[1] * (1 - cosine);
    double E = a->kappa * squares + (1 - 3 * a->kappa) * I4 - 1;
    double slope = E > 0 ? 2 * a->k1 * E * exp(a->k2 * E * E) : 0; /* of both families, by E */
    const double own[3] = {cosine, 1 - cosine, 0};
    verify_constants matrix = {0, a->c, a->bulk};
    verify_isochoric(matrix, l, stress);
    for (int i = 0; i < 3; i++)
        stress[i] += slope * 2 * l[i] * (a->kappa + (1 - 3 * a->kappa) * own[i]);
}

/* Frees the two sides beside `axis` at its stretch. */
static void artery_free(const artery *a, int axis, double l[3], double stress[3])
{
    int b = (axis + 1) % 3, c = (axis + 2) % 3;
    l[b] = l[c] = 1 / sqrt(l[axis]);
    for (int i = 0; i < 200; i++) {
        double h = 1e-7, at[2], slope[2][2], low[3], high[3], det;
        artery_stress(a, l, stress);
        at[0] = stress[b], at[1] = stress[c];
        for (int k = 0; k < 2; k++) {
            double moved[3] = {l[0], l[1], l[2]};
            moved[k ? c : b] += h;
            artery_stress(a, moved, high);
            moved[k ? c : b] -= 2 * h;
            artery_stress(a, moved, low);
            slope[0][k] = (high[b] - low[b]) / (2 * h);
            slope[1][k] = (high[c] - low[c]) / (2 * h);
        }
        det = slope[0][0] * slope[1][1] - slope[0][1] * slope[1][0];
        l[b] -= 0.5 * (slope[1][1] * at[0] - slope[0][1] * at[1]) / det; /* half steps: far from straight at first */
        l[c] -= 0.5 * (slope[0][0] * at[1] - slope[1][0] * at[0]) / det;
    }
    artery_stress(a, l, stress);
}

static sb_material artery_material(const artery *a)
{
    sb_material m = sb_material_neo_hookean_isochoric(REAL(a->c / 2), REAL(2 / a->bulk), 1000);
    return sb_material_with_dispersion(sb_material_with_fibres(m, REAL(a->k1), REAL(a->k2)), REAL(a->kappa));
}

/* A distorted block of 1 m, its families in the plane of x and y. */
static sb_body *fibre_body(sb_mesh *mesh, sb_material material, double angle, sb_integration integration)
{
    sb_body_def def = sb_default_body_def();
    sb_vec3 *first = (sb_vec3 *)malloc(2 * (size_t)mesh->element_count * sizeof *first);
    sb_vec3 *second = first + mesh->element_count;
    sb_body *body;
    for (int e = 0; e < mesh->element_count; e++) {
        first[e] = sb_v3(REAL(cos(angle)), REAL(sin(angle)), 0);
        second[e] = sb_v3(REAL(cos(angle)), REAL(-sin(angle)), 0);
    }
    def.mesh = mesh;
    def.material = material;
    def.fibres = first;
    def.second_fibres = angle > 0 ? second : NULL;
    def.integration = integration;
    body = scene_body(&def);
    free(first);
    return body;
}

static void test_artery(void)
{
    static const char *const names[2] = {"tet4", "hex8"};
    const double amount = 0.1;
    for (int t = 0; t < 2; t++)
        for (int axis = 0; axis < 2; axis++)
            for (int s = 1; s <= 2; s++) {
                const verify_element *element = verify_element_named(names[t]);
                verify_plane far = {axis, 1}, side = {1 - axis, 1};
                double l[3] = {1, 1, 1}, stress[3], stretch = 1 + 0.05 * s;
                sb_mesh mesh = verify_block(element->type, 3, 3, 3, verify_map_distorted, &amount, 1);
                sb_body *body = fibre_body(&mesh, artery_material(&adventitia), adventitia.angle, SB_INTEGRATION_AUTO);
                sb_vec3 pulled = sb_v3(0, 0, 0), force;
                char name[120];
                l[axis] = stretch;
                artery_free(&adventitia, axis, l, stress);
                verify_hold_symmetry(body, &mesh, 3);
                *(axis ? &pulled.y : &pulled.x) = REAL(stretch - 1);
                for (int step = 1; step <= 4; step++) { /* exp(k2 E^2) is steep */
                    verify_move(body, &mesh, verify_on_plane, &far, axis ? SB_Y : SB_X,
                                sb_v3_scale(REAL(step / 4.0), pulled));
                    verify_solve(body);
                }
                force = verify_reaction(body, &mesh, verify_on_plane, &far);
                snprintf(name, sizeof name, "strip of adventitia pulled to %g %s", stretch, axis ? "along" : "around");
                verify(name, names[t], "Gasser, Ogden and Holzapfel 2006, free sides by Newton", "force (N)",
                       stress[axis], (double)(axis ? force.y : force.x), 1e-8);
                force = verify_mean(body, &mesh, verify_on_plane, &side);
                verify(name, names[t], "Gasser, Ogden and Holzapfel 2006, free sides by Newton",
                       "stretch across, in the plane of the fibres", l[1 - axis],
                       (double)(axis ? force.x : force.y) + 1, 1e-8);
                verify_free(body, &mesh);
            }
}

/* mu (l - 1/l^2) = -T f(l) for a free, incompressible bar, f = 1 - ((l - optimum)/width)^2. */
static double muscle_balance(const void *user, double l)
{
    const double *c = (const double *)user; /* T/mu, optimum, width; width 0: f = 1 */
    double away = c[2] > 0 ? (l - c[1]) / c[2] : 0;
    return l - 1 / (l * l) + c[0] * (1 - away * away);
}

static void test_muscle(void)
{
    static const double cases[3][3] = {{0.3, 1, 0}, {1, 1, 0.6}, {2, 1.2, 0.5}};
    const double amount = 0.1, mu = 1000;
    for (int k = 0; k < 3; k++) {
        const verify_element *element = verify_element_named("hex8, B-bar");
        verify_plane far = {0, 1};
        sb_mesh mesh = verify_block(element->type, 3, 3, 3, verify_map_distorted, &amount, 1);
        sb_material material = sb_material_neo_hookean_isochoric(REAL(mu / 2), REAL(2 / (1e4 * mu)), 1000);
        sb_body *body;
        char name[120];
        material = sb_material_with_contraction(material, 0, REAL(cases[k][1]), REAL(cases[k][2]));
        body = fibre_body(&mesh, material, 0, element->integration);
        verify_hold_symmetry(body, &mesh, 3);
        for (int step = 1; step <= 4; step++) {
            CHECK_OK(sb_body_set_tension(body, 0, REAL(cases[k][0] * mu * step / 4), NULL));
            verify_solve(body);
        }
        snprintf(name, sizeof name, "muscle, T/mu = %g, optimum %g, width %g, K/mu = 1e4", cases[k][0], cases[k][1],
                 cases[k][2]);
        verify(name, element->name, "mu (l - 1/l^2) = -T f(l), incompressible", "stretch of the free bar",
               verify_root(muscle_balance, cases[k], 0.4, 1),
               (double)verify_mean(body, &mesh, verify_on_plane, &far).x + 1, 1e-4);
        verify_free(body, &mesh);
    }
}

static void test_table(void) { verify_table("verification_fibres"); }

CHECK_SUITE(verification_fibres, {"artery", test_artery}, {"muscle", test_muscle}, {"table", test_table});
