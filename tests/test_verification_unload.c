/* Rest shapes from loaded images: columns whose rest length is a closed form, on distorted meshes. */
#include <stdlib.h>

#include "verification_scene.h"

typedef struct hung {
    const sb_mesh *image;
} hung;

static sb_result hang(void *user, sb_body *body, sb_real share, sb_error *error)
{
    const sb_mesh *mesh = ((const hung *)user)->image;
    sb_result result = SB_OK;
    (void)share;                         /* gravity alone */
    for (int axis = 0; axis < 3; axis++) /* no side moves across: uniaxial strain */
        for (int i = 0; i < mesh->node_count && result == SB_OK; i++) {
            double at = (double)scene_component(mesh->nodes[i], axis);
            if (axis < 2 || at < 1e-9)
                result = sb_body_hold(body, &i, 1, 1 << axis, error);
        }
    return result;
}

/* A confined column of St. Venant-Kirchhoff, nu 0, hung or standing: P = E l (l^2 - 1)/2 = rho g (H - Z) with Z at
 * rest, so that the rest height H of an image of height h solves h = int l dZ. */
static double column_height(double H, double weight, double young)
{
    const int steps = 2000;
    double sum = 0;
    for (int k = 0; k < steps; k++) {
        double P = weight * H * (1 - (k + 0.5) / steps), l = 1;
        for (int i = 0; i < 50; i++)
            l -= (young * l * (l * l - 1) / 2 - P) / (young * (3 * l * l - 1) / 2);
        sum += l * H / steps;
    }
    return sum;
}

typedef struct column {
    double weight, young, height;
} column;

static double column_gap(const void *user, double H)
{
    const column *c = (const column *)user;
    return column_height(H, c->weight, c->young) - c->height;
}

static void test_columns(void)
{
    static const char *const names[4] = {"tet4", "tet10", "hex8", "hex20"};
    static const double pulls[2] = {2000, -400}; /* rho g (Pa/m) */
    static const double bounds[4] = {4e-4, 4e-5, 2e-4, 1e-5};
    const double amount = 0.1;
    for (int t = 0; t < 4; t++)
        for (int k = 0; k < 2; k++) {
            const verify_element *element = verify_element_named(names[t]);
            sb_mesh mesh = verify_block(element->type, 1, 1, 8, verify_map_distorted, &amount, 1);
            hung h = {&mesh};
            column c = {pulls[k], 5000, 1};
            double top = 0, expected = verify_root(column_gap, &c, 0.7, 1.4);
            sb_unload_def def = sb_default_unload_def();
            sb_unload_report report;
            sb_vec3 *rest = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof *rest);
            char name[100];
            int count = 0;
            def.body.mesh = &mesh;
            def.body.material = sb_material_svk(5000, 0, 1000);
            def.body.integration = element->integration;
            def.body.gravity = sb_v3(0, 0, REAL(pulls[k] / 1000));
            def.dress = hang;
            def.user = &h;
            def.tolerance = REAL(scene_tolerance(1e-9, 1000));
            CHECK_OK(sb_body_unload(&def, rest, NULL, &report, NULL));
            for (int i = 0; i < mesh.node_count; i++)
                if ((double)mesh.nodes[i].z > 1 - 1e-9)
                    top += (double)rest[i].z, count++;
            snprintf(name, sizeof name, "image of a confined column under rho g = %g Pa/m", pulls[k]);
            verify(name, names[t], "E l (l^2 - 1)/2 = rho g (H - Z)", "height of the rest shape (m)", expected,
                   top / count, bounds[t]);
            verify(name, names[t], "the forward solve returns to the image", "largest gap/size", 0,
                   (double)(report.gap / report.size), 1e-9);
            free(rest);
            sb_mesh_free(&mesh);
        }
}

static void test_table(void) { verify_table("verification_unload"); }

CHECK_SUITE(verification_unload, {"columns", test_columns}, {"table", test_table});
