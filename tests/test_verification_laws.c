/* A material law of the caller's own: Gent's, in affine motions whose stress is a closed form, on distorted meshes. */
#include "gent.h"
#include "verification_scene.h"

static sb_body *law_body(const sb_mesh *mesh, const sb_material_law *law, double bulk, sb_integration integration)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.integration = integration;
    def.material = sb_material_custom(law, REAL(bulk), 1000);
    def.tolerance = REAL(scene_tolerance(1e-12, 100));
    return scene_body(&def);
}

/* First Piola-Kirchhoff stress (Pa) along an axis of stretch l of a bar with stretches x, s, s; mu 1 kPa, limit 2.5,
 * K/2 (J - 1)^2 with K 1 MPa. */
static double bar_stress(double x, double s, double l)
{
    double J = x * s * s, I1 = x * x + 2 * s * s, fade = pow(J, -2.0 / 3);
    return 1000 / (1 - (fade * I1 - 3) / 2.5) * fade * (l - I1 / (3 * l)) + 1e6 * (J - 1) * J / l;
}

static double bar_side(const void *user, double s) { return bar_stress(*(const double *)user, s, s); }

/* A bar drawn along x, free beside it, where Newton finds its stretch. */
static void test_bar(void)
{
    static const char *const names[4] = {"tet10, B-bar", "hex8, B-bar", "hex20, B-bar", "hex27, B-bar"};
    static const sb_element_type types[4] = {SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
    static const double stretches[2] = {1.3, 1.7};
    const double amount = 0.1;
    for (int t = 0; t < 4; t++)
        for (int k = 0; k < 2; k++) {
            gent g = {1000, REAL(2.5), 0};
            sb_material_law law = gent_law(&g);
            verify_plane far = {0, 1};
            sb_mesh mesh = verify_block(types[t], 2, 1, 1, verify_map_distorted, &amount, 1);
            sb_body *body = law_body(&mesh, &law, 1e6, SB_INTEGRATION_BBAR);
            double l = stretches[k], side = verify_root(bar_side, &l, 0.99 / sqrt(l), 1.01 / sqrt(l));
            char name[120];
            verify_hold_symmetry(body, &mesh, 3);
            for (int step = 1; step <= 4; step++) {
                verify_move(body, &mesh, verify_on_plane, &far, SB_X, sb_v3(REAL((l - 1) * step / 4), 0, 0));
                verify_solve(body);
            }
            snprintf(name, sizeof name, "a law of the caller's, Gent's with limit 2.5, K/mu = 1e3, pulled to %g", l);
            verify(name, names[t], "dW/dl, its sides free", "force on 1 m^2 (N)", bar_stress(l, side, l),
                   (double)verify_reaction(body, &mesh, verify_on_plane, &far).x, 1e-8);
            verify_free(body, &mesh);
        }
}

/* Simple shear by the whole surface, close to the limit. */
static void test_shear(void)
{
    static const char *const names[4] = {"tet4", "tet10", "hex8", "hex20"};
    static const double gammas[2] = {0.5, 1.4};
    const double amount = 0.1;
    for (int t = 0; t < 4; t++)
        for (int k = 0; k < 2; k++) {
            const verify_element *element = verify_element_named(names[t]);
            gent g = {1000, REAL(2.5), 5000};
            sb_material_law law = gent_law(&g);
            sb_mesh mesh = verify_block(element->type, 2, 2, 2, verify_map_distorted, &amount, 1);
            sb_body *body = law_body(&mesh, &law, 0, element->integration);
            double gamma = gammas[k], worst = 0, expected = 1000 * gamma / (1 - gamma * gamma / 2.5);
            char name[120];
            for (int step = 1; step <= 4; step++) {
                scene_fix_boundary(body, &mesh);
                for (int i = 0; i < mesh.node_count; i++) {
                    sb_vec3 u = sb_v3(REAL(gamma * step / 4) * mesh.nodes[i].y, 0, 0);
                    if (sb_body_supports(body)[i])
                        CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u, 1));
                }
                verify_solve(body);
            }
            for (int e = 0; e < mesh.element_count; e++) {
                sb_mat3 sigma;
                CHECK_OK(sb_body_stress(body, e, 0, &sigma));
                worst = verify_worse(worst, fabs((double)sigma.m[0][1] - expected));
            }
            snprintf(name, sizeof name, "a law of the caller's, Gent's with limit 2.5, shear %g", gamma);
            verify(name, names[t], "mu g/(1 - g^2/limit)", "largest error of sigma_12 (Pa)/its own", 0,
                   worst / expected, 1e-7);
            verify_free(body, &mesh);
        }
}

static void test_table(void) { verify_table("verification_laws"); }

CHECK_SUITE(verification_laws, {"bar", test_bar}, {"shear", test_shear}, {"table", test_table});
