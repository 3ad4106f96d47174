/* Orders of convergence: a manufactured solution in space for every element, integrators in time. */
#include "verification_scene.h"

static const double young = 5e3, poisson = 0.3, density = 1000;

/* ---- the manufactured solution ---- */

/* u_i = 0.1 sin(k_i . X + c_i), on the unit cube. */
static const double wave[3][3] = {{2, 1, -1}, {1, -2, 0.5}, {1, 1, 1.5}}, phase[3] = {0, 1.57, 0.3};

static double angle_of(int i, const double x[3])
{
    return wave[i][0] * x[0] + wave[i][1] * x[1] + wave[i][2] * x[2] + phase[i];
}

static sb_vec3 exact_displacement(const double x[3])
{
    return sb_v3(REAL(0.1 * sin(angle_of(0, x))), REAL(0.1 * sin(angle_of(1, x))), REAL(0.1 * sin(angle_of(2, x))));
}

static sb_mat3 exact_gradient(const double x[3])
{
    sb_mat3 H;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            H.m[i][j] = REAL(0.1 * wave[i][j] * cos(angle_of(i, x)));
    return H;
}

/* First Piola-Kirchhoff stress of F = I + H, written down here again. */
static sb_mat3 stress_linear(verify_constants c, sb_mat3 H)
{
    sb_mat3 e = sb_m3_scale(REAL(c.mu), sb_m3_add(H, sb_m3_transpose(H)));
    return sb_m3_add(e, sb_m3_scale(REAL(c.lambda) * sb_m3_trace(H), sb_m3_identity()));
}

static sb_mat3 stress_neo_hookean(verify_constants c, sb_mat3 H)
{
    sb_mat3 F = sb_m3_add(H, sb_m3_identity()), B = sb_m3_transpose(sb_m3_inverse(F));
    double factor = c.lambda * log((double)sb_m3_det(F)) - c.mu;
    return sb_m3_add(sb_m3_scale(REAL(c.mu), F), sb_m3_scale(REAL(factor), B));
}

typedef struct law {
    const char *name;
    sb_material (*make)(sb_real, sb_real, sb_real);
    sb_mat3 (*stress)(verify_constants c, sb_mat3 H);
} law;

static const law laws[] = {{"linear", sb_material_linear, stress_linear},
                           {"neo_hookean", sb_material_neo_hookean, stress_neo_hookean}};
enum { LAWS = (int)(sizeof laws / sizeof laws[0]) };

/* ---- integrals over elements ---- */

/* Rules of degree 5: 14 points in a tet, Gauss 3x3x3 in a hexahedron. */
static int fine_rule(sb_element_type type, sb_real points[SB_MAX_QUADRATURE_POINTS][3],
                     sb_real weights[SB_MAX_QUADRATURE_POINTS])
{
    static const double at[3] = {-0.774596669241483377, 0, 0.774596669241483377}, w[3] = {5.0 / 9, 8.0 / 9, 5.0 / 9};
    if (sb_element_corner_count(type) == 4)
        return sb_element_quadrature(SB_TET10, SB_QUADRATURE_MASS, points, weights);
    for (int q = 0; q < 27; q++) {
        points[q][0] = REAL(at[q % 3]);
        points[q][1] = REAL(at[q / 3 % 3]);
        points[q][2] = REAL(at[q / 9]);
        weights[q] = REAL(w[q % 3] * w[q / 3 % 3] * w[q / 9]);
    }
    return 27;
}

/* What is needed at a point of an element: position, volume, shape functions and their gradients. */
typedef struct sample {
    const int *nodes;
    int count;
    double x[3], volume;
    sb_real shape[SB_MAX_ELEMENT_NODES];
    sb_vec3 gradient[SB_MAX_ELEMENT_NODES];
} sample;

static void sample_at(const sb_mesh *mesh, int element, const sb_real xi[3], sb_real weight, sample *s)
{
    sb_real local[SB_MAX_ELEMENT_NODES][3];
    sb_mat3 map = sb_m3_zero(), inverse;
    sb_vec3 x = sb_v3(0, 0, 0);
    s->count = sb_element_node_count(mesh->element_type);
    s->nodes = mesh->elements + (size_t)element * (size_t)s->count;
    sb_element_shape(mesh->element_type, xi, s->shape, local);
    for (int a = 0; a < s->count; a++) {
        sb_vec3 at = mesh->nodes[s->nodes[a]];
        x = sb_v3_add(x, sb_v3_scale(s->shape[a], at));
        map = sb_m3_add(map, sb_m3_outer(at, sb_v3(local[a][0], local[a][1], local[a][2])));
    }
    inverse = sb_m3_inverse(map);
    for (int a = 0; a < s->count; a++)
        s->gradient[a] = sb_m3_tapply(inverse, sb_v3(local[a][0], local[a][1], local[a][2]));
    s->x[0] = (double)x.x;
    s->x[1] = (double)x.y;
    s->x[2] = (double)x.z;
    s->volume = (double)(weight * sb_m3_det(map));
}

/* The body force -div P(F) of the exact solution as nodal forces: for nodes inside, int P(F) grad N dX. */
static void add_body_force(sb_body *body, const sb_mesh *mesh, const law *l)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    int count = fine_rule(mesh->element_type, points, weights);
    sample s;
    for (int e = 0; e < mesh->element_count; e++)
        for (int q = 0; q < count; q++) {
            sb_mat3 P;
            sample_at(mesh, e, points[q], weights[q], &s);
            P = l->stress(verify_constants_of(young, poisson), exact_gradient(s.x));
            for (int a = 0; a < s.count; a++) {
                sb_vec3 f = sb_v3_scale(REAL(s.volume), sb_m3_apply(P, s.gradient[a]));
                CHECK_OK(sb_body_add_forces(body, s.nodes + a, 1, &f, 1));
            }
        }
}

/* Norms of u_h - u and of its gradient. */
static void measure(const sb_body *body, const sb_mesh *mesh, double error[2])
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    int count = fine_rule(mesh->element_type, points, weights);
    sample s;
    error[0] = error[1] = 0;
    for (int e = 0; e < mesh->element_count; e++)
        for (int q = 0; q < count; q++) {
            sb_vec3 u;
            sb_mat3 H;
            sample_at(mesh, e, points[q], weights[q], &s);
            u = sb_v3_scale(-1, exact_displacement(s.x));
            H = sb_m3_scale(-1, exact_gradient(s.x));
            for (int a = 0; a < s.count; a++) {
                sb_vec3 own = sb_body_displacements(body)[s.nodes[a]];
                u = sb_v3_add(u, sb_v3_scale(s.shape[a], own));
                H = sb_m3_add(H, sb_m3_outer(own, s.gradient[a]));
            }
            error[0] += s.volume * (double)sb_v3_dot(u, u);
            error[1] += s.volume * (double)sb_m3_ddot(H, H);
        }
    error[0] = sqrt(error[0]);
    error[1] = sqrt(error[1]);
}

static void manufactured(const verify_element *element, const law *l, int cells, double error[2])
{
    sb_mesh mesh = verify_box(element->type, cells, cells, cells, 1, 1, 1);
    sb_body *body = verify_body(&mesh, element, l->make(REAL(young), REAL(poisson), REAL(density)));
    scene_fix_boundary(body, &mesh);
    for (int i = 0; i < mesh.node_count; i++) {
        const double x[3] = {(double)mesh.nodes[i].x, (double)mesh.nodes[i].y, (double)mesh.nodes[i].z};
        sb_vec3 u = exact_displacement(x);
        if (sb_body_supports(body)[i])
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u, 1));
    }
    add_body_force(body, &mesh, l);
    verify_solve(body);
    measure(body, &mesh, error);
    verify_free(body, &mesh);
}

/* Slopes degree + 1 of the displacements and degree of their gradients (Strang and Fix 1973, ch. 3). */
static void test_space(void)
{
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("orders need double");
        return;
    }
    for (int e = 0; e < VERIFY_ELEMENTS; e++)
        for (int k = 0; k < LAWS; k++) {
            const verify_element *element = verify_elements + e;
            int cells = element->degree > 1 ? 3 : 5;
            double coarse[2], fine[2];
            char name[80], what[80];
            if (!verify_suits(element, laws[k].make(1, 0, 1).model))
                continue;
            manufactured(element, laws + k, cells, coarse);
            manufactured(element, laws + k, 2 * cells, fine);
            snprintf(name, sizeof name, "manufactured solution, %d and %d cells per side", cells, 2 * cells);
            snprintf(what, sizeof what, "%s, %s", element->name, laws[k].name);
            verify(name, what, "Strang and Fix 1973: h^(p+1)", "order of the displacements, L2", element->degree + 1,
                   log(coarse[0] / fine[0]) / log(2.0), 0.03);
            verify(name, what, "Strang and Fix 1973: h^p", "order of their gradients, L2", element->degree,
                   log(coarse[1] / fine[1]) / log(2.0), 0.03);
            verify(name, what, "u_i = 0.1 sin(k_i . X + c_i)", "error of the finer mesh (m)", 0, fine[0],
                   element->degree > 1 ? 6e-5 : 1.5e-3);
        }
}

/* ---- time ---- */

enum { SWING_NODES = 20 }; /* 4 x 1 x 1 cells */

/* Displacements of a bar that swings after a push, at time 0.4 s. A push in the shape of the first mode keeps
 * fast modes out of it, which steps of this size do not resolve, and so does stiffness damping. Newmark's
 * rule and generalised alpha go without that where the bar is not linear: their K is the one at the start of
 * a step, which is of first order. Central difference has none. */
static void swing(const law *l, sb_integrator integrator, int steps, double push, sb_vec3 u[SWING_NODES])
{
    sb_mesh mesh = verify_box(SB_HEX8, 4, 1, 1, 0.1, 0.02, 0.02);
    sb_body_def def =
        verify_def(&mesh, verify_element_named("hex8"), l->make(REAL(young), REAL(poisson), REAL(density)));
    sb_vec3 *v = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
    sb_body *body;
    CHECK_INT(mesh.node_count, SWING_NODES);
    def.integrator = integrator;
    if (integrator == SB_EULER || (integrator != SB_CENTRAL_DIFFERENCE && sb_material_is_linear(def.material.model)))
        def.damping_stiffness = REAL(0.005);
    def.tolerance = REAL(1e-12);
    def.newton_tolerance = REAL(1e-12);
    def.max_iterations = 2000;
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int i = 0; i < mesh.node_count; i++) {
        static const double b = 1.8751040687119611;
        double s = (cosh(b) + cos(b)) / (sinh(b) + sin(b)), q = b * 10 * (double)mesh.nodes[i].x;
        v[i] = sb_v3(0, 0, REAL(push * (cosh(q) - cos(q) - s * (sinh(q) - sin(q)))));
    }
    CHECK_OK(sb_body_set_velocities(body, v));
    for (int s = 0; s < steps; s++)
        CHECK_OK(sb_body_step(body, REAL(0.4 / steps), NULL));
    memcpy(u, sb_body_displacements(body), SWING_NODES * sizeof(sb_vec3));
    free(v);
    verify_free(body, &mesh);
}

typedef struct scheme {
    const char *name;
    sb_integrator integrator;
    int order, steps;
    double bound;
} scheme;

static const scheme schemes[] = {{"Euler", SB_EULER, 1, 400, 0.03},
                                 {"Newmark", SB_NEWMARK, 2, 200, 0.1},
                                 {"generalised alpha", SB_GENERALISED_ALPHA, 2, 200, 0.1},
                                 {"central difference", SB_CENTRAL_DIFFERENCE, 2, 400, 0.1}};

/* From three runs with steps of h, h/2, h/4: the order is log2 of the ratio of the two differences. */
static void test_time(void)
{
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("orders need double");
        return;
    }
    for (size_t i = 0; i < sizeof schemes / sizeof schemes[0]; i++)
        for (int k = 0; k < LAWS; k++) {
            const scheme *s = schemes + i;
            sb_vec3 u[3][SWING_NODES];
            char name[80], what[80];
            for (int r = 0; r < 3; r++)
                swing(laws + k, s->integrator, s->steps << r, k ? 0.1 : 0.03, u[r]);
            snprintf(name, sizeof name, "bar swinging for 0.4 s, %d to %d steps", s->steps, s->steps << 2);
            snprintf(what, sizeof what, "%s, hex8, %s", s->name, laws[k].name);
            verify(name, what, "order of the rule (Hughes 1987, sec. 9.1), Richardson", "order in time", s->order,
                   log(scene_distance(u[0], u[1], SWING_NODES) / scene_distance(u[1], u[2], SWING_NODES)) / log(2.0),
                   s->bound);
        }
}

static void test_table(void) { verify_table("verification_convergence"); }

CHECK_SUITE(verification_convergence, {"space", test_space}, {"time", test_time}, {"table", test_table});
