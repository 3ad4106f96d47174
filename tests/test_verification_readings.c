/* Stresses at nodes: a thick cylinder under pressure, plane strain, on meshes that are even in the radius and
 * irregular inside, twice as fine once more, so that the rows show how errors fall. */
#include "verification_scene.h"

static const double young = 1e4, poisson = 0.3, inner = 1, outer = 2, pressure = 100;

/* A quarter ring whose inner points are moved by up to a twentieth of its thickness along the radius and the angle. */
static sb_vec3 irregular_ring(const void *user, double x, double y, double z)
{
    double bump = 16 * x * (1 - x) * y * (1 - y) * 0.05;
    (void)user;
    x += bump * sin(7 * x + 5 * y);
    y += bump * cos(4 * x - 9 * y);
    double r = inner + (outer - inner) * x, a = y * VERIFY_PI / 2;
    return sb_v3(REAL(r * cos(a)), REAL(y == 0 ? 0 : r * sin(a)), REAL(0.1 * z));
}

/* Lame: s_r, s_a = A -+ B/r^2, s_z = 2 nu A. */
static sb_mat3 exact_stress(sb_vec3 at)
{
    double a2 = inner * inner, b2 = outer * outer, x = (double)at.x, y = (double)at.y;
    double A = pressure * a2 / (b2 - a2), r2 = x * x + y * y, D = A * b2 / (r2 * r2);
    sb_mat3 stress = sb_m3_zero();
    stress.m[0][0] = REAL(A - D * (x * x - y * y));
    stress.m[1][1] = REAL(A + D * (x * x - y * y));
    stress.m[0][1] = stress.m[1][0] = REAL(-2 * D * x * y);
    stress.m[2][2] = REAL(2 * poisson * A);
    return stress;
}

typedef struct reading_errors {
    double all, surface, hoop; /* rms over nodes, over those of the inner surface; mean largest principal there */
} reading_errors;

static reading_errors measure(const sb_body *body, const sb_mesh *mesh)
{
    sb_mat3 *values = (sb_mat3 *)malloc((size_t)mesh->node_count * sizeof *values);
    double error[2] = {0, 0}, size[2] = {0, 0}, hoop = 0;
    int on_surface = 0;
    reading_errors e;
    CHECK_OK(sb_body_nodal_tensors(body, SB_TENSOR_STRESS, values, NULL));
    for (int i = 0; i < mesh->node_count; i++) {
        sb_mat3 exact = exact_stress(mesh->nodes[i]), d = sb_m3_sub(values[i], exact);
        int within = verify_on_cylinder(&inner, mesh->nodes[i]);
        for (int k = 0; k <= within; k++) {
            error[k] += (double)sb_m3_ddot(d, d);
            size[k] += (double)sb_m3_ddot(exact, exact);
        }
        if (within) {
            sb_vec3 principal;
            sb_m3_eigen(values[i], &principal, NULL);
            hoop += (double)principal.x;
            on_surface++;
        }
    }
    e.all = sqrt(error[0] / size[0]);
    e.surface = sqrt(error[1] / size[1]);
    e.hoop = hoop / on_surface;
    free(values);
    return e;
}

static reading_errors solve(const verify_element *element, int across)
{
    sb_mesh mesh = verify_block(element->type, across, 2 * across, 1, irregular_ring, NULL, 0);
    sb_body *body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(poisson), 1000));
    reading_errors e;
    verify_hold_symmetry(body, &mesh, 2);
    for (int i = 0; i < mesh.node_count; i++)
        CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_Z));
    verify_load(body, &mesh, verify_on_cylinder, &inner, verify_pressure, &pressure);
    verify_solve(body);
    e = measure(body, &mesh);
    verify_free(body, &mesh);
    return e;
}

static void test_nodal_stresses(void)
{
    static const struct {
        const char *element;
        int across;
        double all, surface, hoop; /* bounds on the finer mesh */
    } cases[] = {{"tet4", 8, 0.06, 0.1, 0.05},      {"tet10", 4, 0.012, 0.016, 0.004},
                 {"hex8", 8, 0.06, 0.14, 0.06},     {"hex8, B-bar", 8, 0.03, 0.07, 0.004},
                 {"hex20", 4, 0.011, 0.015, 0.011}, {"hex27", 4, 0.01, 0.015, 0.011}};
    static const char *source = "Lame 1852, plane strain (Timoshenko and Goodier 1970, sec. 28)";
    double a2 = inner * inner, b2 = outer * outer;
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        const verify_element *element = verify_element_named(cases[i].element);
        reading_errors coarse = solve(element, cases[i].across), fine = solve(element, 2 * cases[i].across);
        char name[80];
        snprintf(name, sizeof name, "thick cylinder b/a = 2, irregular, quarter, %dx%d", 2 * cases[i].across,
                 4 * cases[i].across);
        CHECK(log2(coarse.all / fine.all) > (element->degree == 1 ? 1.1 : 1.6));
        CHECK(log2(coarse.surface / fine.surface) > (element->degree == 1 ? 0.75 : 1.5));
        verify(name, cases[i].element, source, "stress at nodes, error rms, relative", 0, fine.all, cases[i].all);
        verify(name, cases[i].element, source, "the same at r = a", 0, fine.surface, cases[i].surface);
        verify(name, cases[i].element, source, "largest principal stress at r = a, mean (Pa)",
               pressure * (b2 + a2) / (b2 - a2), fine.hoop, cases[i].hoop);
    }
}

static void test_table(void) { verify_table("verification_readings"); }

CHECK_SUITE(verification_readings, {"stresses at nodes", test_nodal_stresses}, {"table", test_table});
