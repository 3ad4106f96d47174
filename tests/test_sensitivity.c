/* test_sensitivity: derivatives of equilibria against central differences of solved ones, directly and by the adjoint,
 * on bodies of all elements and models, and what is refused. */
#include <limits.h>

#include "contact_scene.h"
#include "random_case.h"

/* ---- bodies ---- */

typedef struct sense_body {
    sb_mesh mesh;
    sb_body *body;
    int pressure, mapping, springs;
    int low[64], low_count, high[64], high_count; /* nodes of the ends x = 0 and x = 1 */
} sense_body;

enum { SENSE_MODELS = 12 };

static const sb_real some_g = REAL(0.3), some_tau = REAL(0.5);

/* Models of region 1; E about 5000 Pa. */
static sb_material sense_material(int model)
{
    const sb_real mu[2] = {1000, -300}, alpha[2] = {2, REAL(-2.5)};
    switch (model) {
    case 0: return sb_material_linear(5000, REAL(0.3), 1000);
    case 1: return sb_material_corotated(5000, REAL(0.3), 1000);
    case 2: return sb_material_corotated_invertible(5000, REAL(0.3), 1000);
    case 3: return sb_material_svk(5000, REAL(0.3), 1000);
    case 4: return sb_material_neo_hookean(5000, REAL(0.4), 1000);
    case 5: return sb_material_neo_hookean_isochoric(900, REAL(4e-4), 1000);
    case 6: return sb_material_stable_neo_hookean(5000, REAL(0.4), 1000);
    case 7: return sb_material_mooney_rivlin(600, 300, REAL(4e-4), 1000);
    case 8: return sb_material_reduced_polynomial(900, 400, 300, REAL(4e-4), 1000);
    case 9: return sb_material_ogden(mu, alpha, 2, REAL(4e-4), 1000);
    case 10: return sb_material_fung(900, REAL(1.5), REAL(4e-4), 1000);
    default:
        return sb_material_with_prony(
            sb_material_with_contraction(
                sb_material_with_fibres(sb_material_neo_hookean(4000, REAL(0.35), 1000), 500, 2), 100, REAL(1.2), 1),
            &some_g, &some_tau, 1);
    }
}

static void sense_ends(sense_body *s)
{
    for (int i = 0; i < s->mesh.node_count; i++) {
        if (s->mesh.nodes[i].x < REAL(1e-6) && s->low_count < 64)
            s->low[s->low_count++] = i;
        if (s->mesh.nodes[i].x > REAL(1 - 1e-6) && s->high_count < 64)
            s->high[s->high_count++] = i;
    }
}

/* Cells whose centre is in the right half are region 1. */
static void sense_regions(sb_mesh *mesh)
{
    int n = sb_mesh_element_width(mesh);
    for (int e = 0; e < mesh->element_count; e++) {
        double x = 0;
        for (int a = 0; a < n; a++)
            x += (double)mesh->nodes[mesh->elements[e * n + a]].x / n;
        mesh->regions[e] = x > 0.5;
    }
}

static void sense_loads(sense_body *s)
{
    const sb_vec3 force = sb_v3(REAL(3), REAL(-2), REAL(4));
    const int starts[2] = {0, 2}, nodes[2] = {s->high[0], s->high[s->high_count - 1]};
    const sb_real weights[2] = {REAL(0.4), REAL(0.6)}, k = 30;
    const sb_mapping row = {1, starts, nodes, weights};
    const sb_vec3 target = sb_v3(REAL(1.1), REAL(0.3), REAL(0.2));
    int middle = s->mesh.node_count / 2;
    sb_boundary boundary;
    CHECK_OK(sb_body_add_forces(s->body, s->high, 1, &force, 1));
    CHECK_OK(sb_body_add_mapping(s->body, &row, &k, 1, &target, &s->mapping, NULL));
    CHECK_OK(sb_body_add_springs(s->body, &middle, 1, &k, 1, &s->mesh.nodes[0], &s->springs, NULL));
    if (CHECK_OK(sb_mesh_boundary(&s->mesh, 1, NULL, &boundary, NULL))) {
        const sb_mesh *faces = &boundary.surface;
        int corners = sb_element_straight(s->mesh.element_type) == SB_TET4 ? 3 : 4, face[4];
        for (int f = 0; f < faces->element_count && s->pressure == 0; f++) { /* one face: its rim is open */
            sb_real low = 1;
            for (int c = 0; c < corners; c++) {
                face[c] = boundary.nodes[faces->elements[f * sb_mesh_element_width(faces) + c]];
                low = sb_min(low, s->mesh.nodes[face[c]].z);
            }
            if (low > REAL(0.499))
                CHECK_OK(sb_body_add_pressure(s->body, face, 1, corners, 400, &s->pressure, NULL));
        }
        sb_boundary_free(&boundary);
    }
}

static sense_body sense_make(sb_element_type type, int model, sb_integration integration, int constrained)
{
    sense_body s;
    sb_body_def def = sb_default_body_def();
    sb_region_material soft;
    sb_vec3 *fibres;
    memset(&s, 0, sizeof s);
    s.mesh = scene_box(type, 2, type == SB_TET4 ? 2 : 1, 1, sb_v3(1, REAL(0.5), REAL(0.5)), 0.15);
    if (!s.mesh.regions)
        s.mesh.regions = (int *)calloc((size_t)s.mesh.element_count, sizeof(int));
    sense_regions(&s.mesh);
    sense_ends(&s);
    soft.region = 1;
    soft.material = sense_material(model);
    fibres = (sb_vec3 *)calloc((size_t)s.mesh.element_count, sizeof *fibres);
    for (int e = 0; e < s.mesh.element_count; e++)
        fibres[e] = sb_v3(1, REAL(0.3), REAL(0.1));
    def.mesh = &s.mesh;
    def.material = sense_material(model == 0 ? 0 : model == 1 ? 1 : 6);
    def.region_materials = &soft;
    def.region_material_count = 1;
    def.fibres = fibres;
    def.integration = integration;
    def.gravity = sb_v3(REAL(0.1), REAL(-0.2), REAL(-0.4));
    s.body = scene_body(&def);
    free(fibres);
    CHECK_OK(sb_body_fix_nodes(s.body, s.low, s.low_count, SB_XYZ));
    sense_loads(&s);
    if (constrained) {
        const sb_constraint_term terms[5] = {{s.high[0], 0, 1},
                                             {s.high[1], 0, -1},
                                             {s.high[2], 1, 1},
                                             {s.low[0], 1, REAL(-0.5)},
                                             {s.high[1], 2, REAL(0.3)}};
        const int counts[2] = {2, 3};
        const sb_real values[2] = {0, REAL(0.01)};
        CHECK_OK(sb_body_add_constraints(s.body, terms, counts, values, 2, NULL, NULL));
    }
    return s;
}

static void sense_free(sense_body *s)
{
    sb_body_destroy(s->body);
    sb_mesh_free(&s->mesh);
}

static int sense_solve(sense_body *s)
{
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    options.tolerance = SB_REAL_IS_FLOAT ? REAL(1e-5) : REAL(1e-13);
    options.forces_only = 1;
    if (sb_body_solve_static(s->body, &options, &info) == SB_OK)
        return 1;
    printf("%s\n", info.error.message);
    CHECK(0);
    return 0;
}

/* ---- parameters, and setting them ---- */

static sb_parameter sense_parameter(const sense_body *s, sb_parameter_kind kind, int which)
{
    sb_parameter p;
    memset(&p, 0, sizeof p);
    p.kind = kind;
    p.region = 1;
    p.constant = which;
    p.axis = which % 3;
    p.row = which == 1 ? SB_AUTO : 0;
    p.load_id = kind == SB_PARAMETER_PRESSURE ? s->pressure : which % 2 ? s->springs : s->mapping;
    p.nodes = kind == SB_PARAMETER_SUPPORT ? s->low : s->high;
    p.node_count = 2;
    return p;
}

/* Moduli of a material as its constructors would have set them, shear constants in proportion. */
static sb_material sense_with_moduli(sb_material m, double young, double poisson)
{
    double mu = young / (2 * (1 + poisson)), factor = mu / (double)m.mu;
    double bulk = young / (3 * (1 - 2 * poisson));
    m.mu = REAL(mu);
    m.lambda = REAL(bulk - 2 * mu / 3);
    m.c10 = REAL(factor * (double)m.c10);
    m.c01 = REAL(factor * (double)m.c01);
    m.c20 = REAL(factor * (double)m.c20);
    m.c30 = REAL(factor * (double)m.c30);
    for (int i = 0; i < SB_MAX_OGDEN_TERMS; i++)
        m.ogden_mu[i] = REAL(factor * (double)m.ogden_mu[i]);
    m.d1 = REAL(2 / bulk);
    return m;
}

/* lambda and mu that go with the other constants of an isochoric material. */
static sb_material sense_settled(sb_material m)
{
    double mu = 2 * ((double)m.c10 + (double)m.c01);
    if (m.model == SB_OGDEN) {
        mu = 0;
        for (int i = 0; i < SB_MAX_OGDEN_TERMS; i++)
            mu += (double)m.ogden_mu[i] * (double)m.ogden_alpha[i] / 2;
        m.c10 = REAL(mu / 2);
    }
    m.mu = REAL(mu);
    m.lambda = REAL(2 / (double)m.d1 - 2 * mu / 3);
    return m;
}

static sb_material sense_with_constant(sb_material m, int constant, double change)
{
    int isochoric = m.model == SB_NEO_HOOKEAN_ISOCHORIC || m.model >= SB_MOONEY_RIVLIN;
    sb_real *places[9], c = REAL(change);
    places[0] = &m.lambda, places[1] = &m.mu, places[2] = &m.c10, places[3] = &m.c01, places[4] = &m.c20;
    places[5] = &m.c30, places[6] = &m.d1, places[7] = &m.fibre_stiffness, places[8] = &m.fibre_tension;
    if (constant >= SB_CONSTANT_OGDEN_MU)
        m.ogden_mu[constant - SB_CONSTANT_OGDEN_MU] += c;
    else
        *places[constant - 1] += c;
    if (isochoric && constant != SB_CONSTANT_FIBRE_STIFFNESS && constant != SB_CONSTANT_FIBRE_TENSION)
        return sense_settled(m);
    m.c10 = m.mu / 2;
    if (!isochoric)
        m.d1 = 2 / sb_material_bulk(&m);
    return m;
}

static void sense_change_material(sense_body *s, int model, const sb_parameter *p, double change)
{
    sb_material m = sense_material(model);
    if (p->kind == SB_PARAMETER_YOUNG)
        m = sense_with_moduli(m, (double)sb_material_young(&m) + change, (double)sb_material_poisson(&m));
    if (p->kind == SB_PARAMETER_POISSON)
        m = sense_with_moduli(m, (double)sb_material_young(&m), (double)sb_material_poisson(&m) + change);
    if (p->kind == SB_PARAMETER_CONSTANT)
        m = sense_with_constant(m, p->constant, change);
    if (p->kind == SB_PARAMETER_DENSITY)
        m.density += REAL(change);
    CHECK_OK(sb_body_set_region_material(s->body, 1, &m, NULL));
}

static void sense_change_rows(sense_body *s, const sb_parameter *p, double change)
{
    sb_vec3 point = p->load_id == s->springs ? s->mesh.nodes[0] : sb_v3(REAL(1.1), REAL(0.3), REAL(0.2));
    sb_real k = 30;
    if (p->kind == SB_PARAMETER_STIFFNESS)
        k += REAL(change);
    else if (p->axis == 0)
        point.x += REAL(change);
    else if (p->axis == 1)
        point.y += REAL(change);
    else
        point.z += REAL(change);
    if (p->load_id == s->springs) {
        CHECK_OK(sb_body_set_spring_stiffness(s->body, s->springs, &k, 1));
        CHECK_OK(sb_body_move_springs(s->body, s->springs, &point));
    } else {
        CHECK_OK(sb_body_set_mapping_stiffness(s->body, s->mapping, &k, 1));
        CHECK_OK(sb_body_set_mapping_targets(s->body, s->mapping, &point));
    }
}

static void sense_change(sense_body *s, int model, const sb_parameter *p, double change)
{
    sb_vec3 along =
        sb_v3(p->axis == 0 ? REAL(change) : 0, p->axis == 1 ? REAL(change) : 0, p->axis == 2 ? REAL(change) : 0);
    const sb_vec3 force = sb_v3(REAL(3), REAL(-2), REAL(4)), g = sb_v3(REAL(0.1), REAL(-0.2), REAL(-0.4));
    if (p->kind <= SB_PARAMETER_DENSITY)
        sense_change_material(s, model, p, change);
    if (p->kind == SB_PARAMETER_STIFFNESS || p->kind == SB_PARAMETER_TARGET)
        sense_change_rows(s, p, change);
    if (p->kind == SB_PARAMETER_GRAVITY)
        CHECK_OK(sb_body_set_gravity(s->body, sb_v3_add(g, along)));
    if (p->kind == SB_PARAMETER_PRESSURE)
        CHECK_OK(sb_body_set_pressure(s->body, s->pressure, REAL(400 + change)));
    if (p->kind == SB_PARAMETER_SUPPORT)
        CHECK_OK(sb_body_prescribe(s->body, p->nodes, p->node_count, 1 << p->axis, &along, 1));
    if (p->kind == SB_PARAMETER_FORCE) {
        sb_body_clear_loads(s->body);
        CHECK_OK(sb_body_add_forces(s->body, s->high, 1, &force, 1));
        CHECK_OK(sb_body_add_forces(s->body, p->nodes, p->node_count, &along, 1));
    }
}

/* How far a derivative may be stepped for differences of 1e-7 or better. */
static double sense_stride(int model, const sb_parameter *p)
{
    sb_material m = sense_material(model);
    switch (p->kind) {
    case SB_PARAMETER_YOUNG: return 2;
    case SB_PARAMETER_POISSON: return 1e-4;
    case SB_PARAMETER_CONSTANT: return p->constant == SB_CONSTANT_D1 ? 1e-3 * (double)m.d1 : 1;
    case SB_PARAMETER_DENSITY: return 1;
    case SB_PARAMETER_GRAVITY: return 2e-4;
    case SB_PARAMETER_FORCE: return 1e-2;
    case SB_PARAMETER_PRESSURE: return 1;
    case SB_PARAMETER_STIFFNESS: return 0.01;
    default: return 1e-4;
    }
}

/* ---- comparisons ---- */

static double sense_norm(const sb_vec3 *v, int n)
{
    double sum = 0;
    for (int i = 0; i < n; i++)
        sum += (double)sb_v3_dot(v[i], v[i]);
    return sqrt(sum);
}

/* (value at +h less value at -h) / 2h of displacements and reactions, relative to the derivative. */
static void sense_compare(sense_body *s, int model, const sb_parameter *p, const sb_vec3 *du, const sb_vec3 *dr)
{
    int n = s->mesh.node_count;
    size_t bytes = (size_t)n * sizeof(sb_vec3);
    double h = sense_stride(model, p), wrong, size;
    sb_vec3 *u = (sb_vec3 *)malloc(2 * bytes), *r = u + n;
    sense_change(s, model, p, h);
    if (sense_solve(s)) {
        memcpy(u, sb_body_displacements(s->body), bytes);
        memcpy(r, sb_body_reactions(s->body), bytes);
    }
    sense_change(s, model, p, -h);
    sense_solve(s);
    for (int i = 0; i < n; i++) {
        u[i] = sb_v3_sub(sb_v3_scale(REAL(0.5 / h), sb_v3_sub(u[i], sb_body_displacements(s->body)[i])), du[i]);
        r[i] = sb_v3_sub(sb_v3_scale(REAL(0.5 / h), sb_v3_sub(r[i], sb_body_reactions(s->body)[i])), dr[i]);
    }
    sense_change(s, model, p, 0);
    size = sense_norm(du, n);
    wrong = sense_norm(u, n);
    if (!CHECK(wrong <= 1e-6 * size + 1e-12))
        printf("  kind %d, %d of model %d: %g of %g\n", (int)p->kind, p->constant, model, wrong, size);
    size = sense_norm(dr, n);
    wrong = sense_norm(r, n);
    if (!CHECK(wrong <= 1e-6 * size + 1e-9))
        printf("  kind %d, %d of model %d, reactions: %g of %g\n", (int)p->kind, p->constant, model, wrong, size);
    free(u);
}

enum { SENSE_MOST = 32 };

static int sense_list(const sense_body *s, int model, sb_parameter *list)
{
    int count = 0;
    sb_material m = sense_material(model);
    list[count++] = sense_parameter(s, SB_PARAMETER_YOUNG, 0);
    list[count++] = sense_parameter(s, SB_PARAMETER_POISSON, 0);
    list[count++] = sense_parameter(s, SB_PARAMETER_DENSITY, 0);
    for (int k = SB_PARAMETER_GRAVITY; k <= SB_PARAMETER_SUPPORT; k++)
        for (int which = 0; which < 2; which++)
            list[count++] = sense_parameter(s, (sb_parameter_kind)k, which + k % 2);
    for (int c = SB_CONSTANT_LAMBDA; c < SB_CONSTANT_OGDEN_MU + 3; c++) {
        sb_vec3 *du = (sb_vec3 *)malloc((size_t)s->mesh.node_count * sizeof *du);
        list[count] = sense_parameter(s, SB_PARAMETER_CONSTANT, c);
        if (sb_body_sensitivities(s->body, &list[count], 1, du, NULL, NULL) == SB_OK)
            count++;
        free(du);
    }
    CHECK(count >= 15 + (m.model == SB_REDUCED_POLYNOMIAL ? 4 : 1));
    return count;
}

/* dJ/dp of a random loss by the adjoint, and the same from the derivatives of all. */
static void sense_compare_adjoint(sense_body *s, const sb_parameter *list, int count, const sb_vec3 *du,
                                  const sb_vec3 *dr)
{
    int n = s->mesh.node_count;
    unsigned long long seed = 3;
    sb_real gradient[SENSE_MOST];
    sb_vec3 *weights = (sb_vec3 *)malloc(3 * (size_t)n * sizeof *weights), *force = weights + 2 * n;
    for (int i = 0; i < 2 * n; i++)
        weights[i] = sb_v3_scale(i < n ? 1 : REAL(1e-3), random_direction(&seed));
    CHECK_OK(sb_body_gradient(s->body, weights, weights + n, list, count, gradient, force, NULL));
    for (int k = 0; k < count; k++) {
        double sum = 0, size = 0;
        for (int i = 0; i < n; i++) {
            double a = (double)sb_v3_dot(weights[i], du[k * n + i]),
                   b = (double)sb_v3_dot(weights[n + i], dr[k * n + i]);
            sum += a + b;
            size += fabs(a) + fabs(b);
        }
        CHECK_NEAR((double)gradient[k], sum, size * scene_tolerance(1e-9, 1e4));
        if (list[k].kind == SB_PARAMETER_FORCE) {
            double by = 0;
            for (int i = 0; i < list[k].node_count; i++)
                by += (double)scene_component(force[list[k].nodes[i]], list[k].axis);
            CHECK_NEAR((double)gradient[k], by, 1e-12 * fabs(by) + scene_tolerance(0, 1e2) * fabs(by));
        }
    }
    free(weights);
}

/* every: of how many parameters one is compared with differences. */
static void sense_run(sb_element_type type, int model, sb_integration integration, int constrained, int every)
{
    sense_body s = sense_make(type, model, integration, constrained);
    int n = s.mesh.node_count, count;
    sb_parameter list[SENSE_MOST];
    sb_vec3 *du, *dr;
    unsigned long long before;
    sb_error error;
    if (!sense_solve(&s)) {
        sense_free(&s);
        return;
    }
    count = sense_list(&s, model, list);
    du = (sb_vec3 *)malloc(2 * (size_t)(count * n) * sizeof *du);
    dr = du + count * n;
    before = scene_hash(sb_body_displacements(s.body), (size_t)n * sizeof *du);
    if (CHECK_OK(sb_body_sensitivities(s.body, list, count, du, dr, &error))) {
        sense_compare_adjoint(&s, list, count, du, dr);
        CHECK(scene_hash(sb_body_displacements(s.body), (size_t)n * sizeof *du) == before);
        for (int k = 0; !SB_REAL_IS_FLOAT && k < count; k += every)
            sense_compare(&s, model, &list[k], du + k * n, dr + k * n);
    } else {
        printf("%s\n", error.message);
    }
    free(du);
    sense_free(&s);
}

/* ---- tests ---- */

static void test_models(void)
{
    for (int model = 0; model < SENSE_MODELS; model += check_quick() ? 4 : 1)
        sense_run(SB_TET4, model, SB_INTEGRATION_AUTO, model % 2, model % 4 == 3 ? 1 : 2);
}

static void test_elements(void)
{
    static const sb_element_type types[5] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
    for (int t = 0; t < (check_quick() ? 3 : 5); t++)
        sense_run(types[t], t % 2 ? 6 : 1, SB_INTEGRATION_AUTO, t % 2, 3);
}

static void test_bbar(void)
{
    sense_run(SB_HEX8, 7, SB_INTEGRATION_BBAR, 1, 3);
    sense_run(SB_TET10, 11, SB_INTEGRATION_BBAR, 0, 3);
}

/* K x = rhs: what small forces displace, and K is symmetric where no pressure pushes. */
static void test_solve(void)
{
    sense_body s = sense_make(SB_TET10, 6, SB_INTEGRATION_AUTO, 1);
    int n = s.mesh.node_count;
    unsigned long long seed = 5;
    sb_vec3 *f = (sb_vec3 *)calloc(6 * (size_t)n, sizeof *f), *x = f + 2 * n, *u = x + 2 * n;
    const double h = SB_REAL_IS_FLOAT ? 1e-1 : 1e-4;
    sense_solve(&s);
    for (int i = 0; i < 2 * n; i++)
        f[i] = random_direction(&seed);
    CHECK_OK(sb_body_solve_tangent(s.body, f, x, 2, REAL(1e-9), NULL));
    for (int side = 0; side < 2; side++) {
        for (int i = 0; i < n; i++) {
            sb_vec3 push = sb_v3_scale(REAL(side ? -2 * h : h), f[i]);
            CHECK_OK(sb_body_add_forces(s.body, &i, 1, &push, 1));
        }
        sense_solve(&s);
        for (int i = 0; i < n; i++)
            u[i] = side ? sb_v3_sub(u[i], sb_body_displacements(s.body)[i]) : sb_body_displacements(s.body)[i];
    }
    for (int i = 0; i < n; i++)
        u[i] = sb_v3_sub(sb_v3_scale(REAL(0.5 / h), u[i]), x[i]);
    CHECK(sense_norm(u, n) <= (SB_REAL_IS_FLOAT ? 0.05 : 1e-6) * sense_norm(x, n));
    CHECK_OK(sb_body_set_pressure(s.body, s.pressure, 0));
    sense_solve(&s);
    CHECK_OK(sb_body_solve_tangent(s.body, f, x, 2, REAL(1e-9), NULL));
    {
        double a = 0, b = 0;
        for (int i = 0; i < n; i++) {
            a += (double)sb_v3_dot(f[i], x[n + i]);
            b += (double)sb_v3_dot(f[n + i], x[i]);
        }
        CHECK_NEAR(a, b, scene_tolerance(1e-12, 1e4) * fabs(a) + scene_tolerance(1e-14, 1e3) * sense_norm(x, n));
    }
    CHECK_OK(sb_body_solve_tangent(s.body, f, f, 2, REAL(1e-9), NULL)); /* in place, together: same bits */
    CHECK(memcmp(f, x, 2 * (size_t)n * sizeof *f) == 0);
    free(f);
    sense_free(&s);
}

/* A hanging bar: u = rho g L^2 / 2 E at its end. */
static void test_bar(void)
{
    sb_mesh mesh = scene_box(SB_HEX8, 6, 2, 2, sb_v3(1, REAL(0.2), REAL(0.2)), 0);
    sb_body_def def = sb_default_body_def();
    sb_parameter p[3];
    sb_real gradient[3];
    sb_body *body;
    sb_vec3 *loss = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof *loss);
    double tip = 1000 * 2 * 1 / (2 * 5e4);
    sb_static_options options = sb_default_static_options();
    def.mesh = &mesh;
    def.material = sb_material_linear(REAL(5e4), 0, 1000);
    def.gravity = sb_v3(2, 0, 0);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    options.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-11);
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    memset(p, 0, sizeof p);
    p[0].kind = SB_PARAMETER_YOUNG, p[1].kind = SB_PARAMETER_DENSITY, p[2].kind = SB_PARAMETER_GRAVITY;
    loss[mesh.node_count - 1].x = 1;
    CHECK_OK(sb_body_gradient(body, loss, NULL, p, 3, gradient, NULL, NULL));
    CHECK_NEAR((double)gradient[0], -tip / 5e4, scene_tolerance(1e-8, 1e3) * tip / 5e4);
    CHECK_NEAR((double)gradient[1], tip / 1000, scene_tolerance(1e-8, 1e3) * tip / 1000);
    CHECK_NEAR((double)gradient[2], tip / 2, scene_tolerance(1e-8, 1e3) * tip / 2);
    free(loss);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void sense_refuse(sense_body *s, sb_parameter p, sb_result expected)
{
    sb_error error;
    sb_real gradient = 7;
    sb_vec3 *du = (sb_vec3 *)calloc((size_t)s->mesh.node_count, sizeof *du);
    CHECK_RESULT(sb_body_sensitivities(s->body, &p, 1, du, NULL, &error), expected);
    CHECK(error.message[0] != 0 && sense_norm(du, s->mesh.node_count) == 0);
    CHECK_RESULT(sb_body_gradient(s->body, du, NULL, &p, 1, &gradient, NULL, &error), expected);
    CHECK(gradient == 7);
    free(du);
}

static void test_refused(void)
{
    sense_body s = sense_make(SB_TET4, 6, SB_INTEGRATION_AUTO, 0);
    sb_parameter good, p;
    const int wrong[1] = {-1};
    const sb_vec3 more = sb_v3(1, 0, 0);
    good = sense_parameter(&s, SB_PARAMETER_YOUNG, 0);
    sense_refuse(&s, good, SB_ERROR_NOT_CONVERGED); /* nothing was solved */
    sense_solve(&s);
    p = good, p.kind = (sb_parameter_kind)0, sense_refuse(&s, p, SB_ERROR_ARGUMENT);
    p = good, p.kind = (sb_parameter_kind)11, sense_refuse(&s, p, SB_ERROR_ARGUMENT);
    p = good, p.region = 2, sense_refuse(&s, p, SB_ERROR_INDEX);
    p = sense_parameter(&s, SB_PARAMETER_CONSTANT, SB_CONSTANT_C10), sense_refuse(&s, p, SB_ERROR_ARGUMENT);
    p = sense_parameter(&s, SB_PARAMETER_CONSTANT, 0), sense_refuse(&s, p, SB_ERROR_ARGUMENT);
    p = sense_parameter(&s, SB_PARAMETER_CONSTANT, INT_MAX), sense_refuse(&s, p, SB_ERROR_ARGUMENT);
    p = sense_parameter(&s, SB_PARAMETER_CONSTANT, INT_MIN), sense_refuse(&s, p, SB_ERROR_ARGUMENT);
    p = sense_parameter(&s, SB_PARAMETER_PRESSURE, 0), p.load_id = s.mapping, sense_refuse(&s, p, SB_ERROR_INDEX);
    p = sense_parameter(&s, SB_PARAMETER_TARGET, 0), p.load_id = s.pressure, sense_refuse(&s, p, SB_ERROR_INDEX);
    p = sense_parameter(&s, SB_PARAMETER_STIFFNESS, 0), p.row = 1, sense_refuse(&s, p, SB_ERROR_INDEX);
    p = sense_parameter(&s, SB_PARAMETER_GRAVITY, 0), p.axis = 3, sense_refuse(&s, p, SB_ERROR_ARGUMENT);
    p = sense_parameter(&s, SB_PARAMETER_SUPPORT, 0), p.nodes = s.high, sense_refuse(&s, p, SB_ERROR_ARGUMENT);
    p = sense_parameter(&s, SB_PARAMETER_FORCE, 0), p.nodes = wrong, p.node_count = 1,
    sense_refuse(&s, p, SB_ERROR_INDEX);
    p = sense_parameter(&s, SB_PARAMETER_FORCE, 0), p.nodes = NULL, sense_refuse(&s, p, SB_ERROR_ARGUMENT);
    CHECK_OK(sb_body_add_forces(s.body, s.high, 1, &more, 1));
    sense_refuse(&s, good, SB_ERROR_NOT_CONVERGED);
    sense_solve(&s);
    CHECK_OK(sb_body_prescribe(s.body, s.low, 1, SB_X, &more, 1));
    sense_refuse(&s, good, SB_ERROR_NOT_CONVERGED);
    CHECK_OK(sb_body_release_nodes(s.body, s.low, s.low_count, SB_XYZ));
    CHECK_OK(sb_body_remove_load(s.body, s.mapping));
    CHECK_OK(sb_body_remove_load(s.body, s.springs));
    sense_refuse(&s, good, SB_ERROR_UNCONSTRAINED);
    sense_free(&s);
}

/* A tool that does not touch changes nothing; one that presses, and single rotations, are refused. */
static void test_unsupported(void)
{
    const sb_vec3 far = sb_v3(REAL(0.3), REAL(0.1), REAL(0.5)), near = sb_v3(REAL(0.3), REAL(0.1), REAL(0.22));
    sb_body_def def = sb_default_body_def();
    sb_tool_def tool = press_sphere(0.04, 0, far);
    sb_parameter p;
    sb_real gradient[2];
    sb_vec3 *loss;
    press s;
    int number;
    memset(&p, 0, sizeof p);
    p.kind = SB_PARAMETER_YOUNG;
    def.material = sb_material_neo_hookean(5000, REAL(0.3), 1000);
    def.gravity = sb_v3(0, 0, REAL(-0.2));
    s = press_make(scene_box(SB_TET4, 6, 2, 2, sb_v3(REAL(0.6), REAL(0.2), REAL(0.2)), 0.1), def, press_exact());
    loss = (sb_vec3 *)calloc((size_t)s.mesh.node_count, sizeof *loss);
    loss[s.mesh.node_count - 1].z = 1;
    scene_fix_plane(s.body, &s.mesh, 2, 0, SB_XYZ);
    CHECK_OK(sb_body_solve_static(s.body, NULL, NULL));
    CHECK_OK(sb_body_gradient(s.body, loss, NULL, &p, 1, &gradient[0], NULL, NULL));
    number = press_add(&s, &tool);
    CHECK_OK(sb_body_solve_static(s.body, NULL, NULL));
    CHECK_OK(sb_body_gradient(s.body, loss, NULL, &p, 1, &gradient[1], NULL, NULL));
    CHECK_NEAR((double)gradient[1], (double)gradient[0], scene_tolerance(1e-4, 1e5) * fabs((double)gradient[0]));
    for (int k = 1; k <= 8; k++) {
        press_move(&s, number, sb_v3_madd(far, REAL(k / 8.0), sb_v3_sub(near, far)), sb_quat_identity());
        CHECK_OK(sb_body_solve_static(s.body, NULL, NULL));
    }
    gradient[1] = 7;
    CHECK_RESULT(sb_body_gradient(s.body, loss, NULL, &p, 1, &gradient[1], NULL, NULL), SB_ERROR_UNSUPPORTED);
    CHECK(gradient[1] == 7);
    press_free(&s);
    def.mesh = &s.mesh;
    s.mesh = scene_box(SB_TET10, 2, 1, 1, sb_v3(1, 1, 1), 0);
    def.material = sb_material_corotated(5000, REAL(0.3), 1000);
    def.single_rotation = 1;
    s.contact = NULL;
    s.body = scene_body(&def);
    scene_fix_plane(s.body, &s.mesh, 2, 0, SB_XYZ);
    CHECK_OK(sb_body_solve_static(s.body, NULL, NULL));
    CHECK_RESULT(sb_body_gradient(s.body, loss, NULL, &p, 1, &gradient[1], NULL, NULL), SB_ERROR_UNSUPPORTED);
    press_free(&s);
    free(loss);
}

/* Each allocation fails in turn: an error, or conjugate gradients in place of the factor, and nothing is lost. */
static void test_without_memory(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(1, REAL(0.5), REAL(0.5)), 0.1);
    sb_body_def def = sb_default_body_def();
    scene_memory memory = {0, 0, 0, 0};
    sb_parameter p;
    sb_body *body;
    sb_real with, without;
    sb_boundary boundary;
    int calls, live, id, other = 0;
    sb_vec3 *loss = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof *loss);
    memset(&p, 0, sizeof p);
    p.kind = SB_PARAMETER_YOUNG;
    def.mesh = &mesh;
    def.material = sb_material_neo_hookean(5000, REAL(0.3), 1000);
    def.gravity = sb_v3(0, 0, REAL(-0.2));
    def.allocator = scene_allocator(&memory);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    if (CHECK_OK(sb_mesh_boundary(&mesh, 1, NULL, &boundary, NULL))) { /* one face of the end: its rim is open */
        const int *faces = boundary.surface.elements, *nodes = boundary.nodes;
        int f = 0, face[3];
        while (mesh.nodes[nodes[faces[3 * f]]].x + mesh.nodes[nodes[faces[3 * f + 1]]].x +
                   mesh.nodes[nodes[faces[3 * f + 2]]].x <
               REAL(2.999))
            f++;
        for (int c = 0; c < 3; c++)
            face[c] = nodes[faces[3 * f + c]];
        CHECK_OK(sb_body_add_pressure(body, face, 1, 3, 100, &id, NULL));
        sb_boundary_free(&boundary);
    }
    CHECK_OK(sb_body_solve_static(body, NULL, NULL));
    loss[mesh.node_count - 1].z = 1;
    live = memory.live;
    calls = memory.calls;
    CHECK_OK(sb_body_gradient(body, loss, NULL, &p, 1, &with, NULL, NULL));
    calls = memory.calls - calls;
    for (int k = 1; k <= calls; k++) {
        sb_result result;
        memory.fail_at = memory.calls + k;
        result = sb_body_gradient(body, loss, NULL, &p, 1, &without, NULL, NULL);
        memory.fail_at = 0;
        CHECK_INT(memory.live, live);
        if (result != SB_OK) {
            CHECK_RESULT(result, SB_ERROR_MEMORY);
            continue;
        }
        other++;
        CHECK_NEAR((double)without, (double)with, scene_tolerance(1e-8, 1e4) * fabs((double)with));
    }
    CHECK(other > 0);
    free(loss);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* A column that is pressed beyond what it bears has no derivative that is true of anything. */
static void test_unstable(void)
{
    sb_mesh mesh = scene_box(SB_HEX20, 8, 1, 1, sb_v3(1, REAL(0.05), REAL(0.05)), 0);
    sb_body_def def = sb_default_body_def();
    sb_vec3 *v = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof *v);
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_svk(REAL(1e5), 0, 1000);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int i = 0; i < mesh.node_count; i++)
        v[i].x = REAL(-0.01) * mesh.nodes[i].x; /* evenly short: 5 times Euler's load */
    scene_fix_plane(body, &mesh, 0, 1, SB_X);
    CHECK_OK(sb_body_set_displacements(body, v));
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].x > REAL(0.999))
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_X, &v[i], 1));
    CHECK_RESULT(sb_body_solve_tangent(body, v, v, 1, REAL(1e-6), NULL), SB_ERROR_INDEFINITE);
    free(v);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(sensitivity, {"solve", test_solve}, {"hanging bar", test_bar}, {"models", test_models},
            {"elements", test_elements}, {"mean points", test_bbar}, {"refused", test_refused},
            {"unsupported", test_unsupported}, {"without memory", test_without_memory}, {"unstable", test_unstable});
