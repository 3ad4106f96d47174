/* test_identify: moduli of a phantom's core and shell from forces and markers, what cannot be told, and how well. */
#include "random_case.h"

enum { PHANTOM_STATES = 3, PHANTOM_MARKERS = 8 };

/* A block with a stiff core, pressed in at its top in three depths; everything that a measurement needs. */
typedef struct phantom {
    sb_mesh mesh;
    sb_body *body;
    int top[64], top_count;
    double depth[PHANTOM_STATES];
    int starts[PHANTOM_MARKERS + 1], nodes[PHANTOM_MARKERS];
    sb_real weights[PHANTOM_MARKERS];
    sb_mapping markers;
    sb_vec3 points[PHANTOM_STATES][PHANTOM_MARKERS];
    sb_measurement seen[PHANTOM_STATES];
    sb_parameter parameters[3];
    sb_result answer; /* of apply */
} phantom;

static sb_result phantom_apply(void *user, int state, const sb_real *free_values, sb_body *body, sb_error *error)
{
    phantom *p = (phantom *)user;
    sb_vec3 down = sb_v3(0, 0, REAL(-p->depth[state]));
    (void)free_values, (void)error;
    if (p->answer != SB_OK)
        return p->answer;
    return sb_body_prescribe(body, p->top, p->top_count, SB_XYZ, &down, 1);
}

static void phantom_name(phantom *p)
{
    memset(p->parameters, 0, sizeof p->parameters);
    p->parameters[0].kind = p->parameters[1].kind = SB_PARAMETER_YOUNG;
    p->parameters[1].region = 1;
    p->parameters[2].kind = SB_PARAMETER_POISSON;
}

static void phantom_shape(phantom *p, int cells)
{
    p->mesh = scene_box(SB_HEX8, cells, cells, cells, sb_v3(REAL(0.05), REAL(0.05), REAL(0.05)), 0.1);
    if (!p->mesh.regions)
        p->mesh.regions = (int *)calloc((size_t)p->mesh.element_count, sizeof(int));
    for (int e = 0; e < p->mesh.element_count; e++) {
        sb_vec3 c = sb_v3(0, 0, 0);
        for (int a = 0; a < 8; a++)
            c = sb_v3_madd(c, REAL(0.125), p->mesh.nodes[p->mesh.elements[8 * e + a]]);
        c = sb_v3_sub(c, sb_v3(REAL(0.025), REAL(0.025), REAL(0.025)));
        p->mesh.regions[e] = sb_abs(c.x) < REAL(0.0151) && sb_abs(c.y) < REAL(0.0151) && sb_abs(c.z) < REAL(0.0151);
    }
    for (int i = 0; i < p->mesh.node_count; i++) {
        sb_vec3 x = p->mesh.nodes[i];
        if (x.z > REAL(0.0499) && x.x > REAL(0.012) && x.x < REAL(0.038) && x.y > REAL(0.012) && x.y < REAL(0.038))
            p->top[p->top_count++] = i;
    }
}

/* What the body says with moduli young (shell, core) and nu: readings without noise. */
static void phantom_measure(phantom *p)
{
    for (int s = 0; s < PHANTOM_STATES; s++) {
        sb_static_options options = sb_default_static_options();
        sb_measurement *m = &p->seen[s];
        options.tolerance = SB_REAL_IS_FLOAT ? REAL(1e-5) : REAL(1e-11);
        CHECK_OK(phantom_apply(p, s, NULL, p->body, NULL));
        CHECK_OK(sb_body_solve_static(p->body, &options, NULL));
        memset(m, 0, sizeof *m);
        sb_mapping_apply(&p->markers, sb_body_positions(p->body), p->points[s]);
        for (int i = 0; i < p->top_count; i++)
            m->force = sb_v3_add(m->force, sb_body_reactions(p->body)[p->top[i]]);
        m->rows = &p->markers;
        m->points = p->points[s];
        m->sigma_point = REAL(1e-4);
        m->force_nodes = p->top;
        m->force_count = p->top_count;
        m->sigma_force = REAL(0.02) * sb_v3_norm(m->force);
    }
}

static void phantom_make(phantom *p, int cells, const sb_allocator *allocator)
{
    sb_body_def def = sb_default_body_def();
    sb_region_material core;
    unsigned long long seed = 17;
    memset(p, 0, sizeof *p);
    phantom_shape(p, cells);
    phantom_name(p);
    core.region = 1;
    core.material = sb_material_neo_hookean(12000, REAL(0.42), 1000);
    def.mesh = &p->mesh;
    def.material = sb_material_neo_hookean(4000, REAL(0.42), 1000);
    def.region_materials = &core;
    def.region_material_count = 1;
    if (allocator)
        def.allocator = *allocator;
    p->body = scene_body(&def);
    scene_fix_plane(p->body, &p->mesh, 2, 0, SB_XYZ);
    for (int s = 0; s < PHANTOM_STATES; s++)
        p->depth[s] = 0.004 * (s + 1);
    for (int k = 0; k < PHANTOM_MARKERS; k++) {
        p->starts[k + 1] = k + 1;
        p->weights[k] = 1;
        do
            p->nodes[k] = random_below(&seed, p->mesh.node_count);
        while (p->mesh.nodes[p->nodes[k]].z < REAL(0.01) || p->mesh.nodes[p->nodes[k]].z > REAL(0.0499));
    }
    p->markers.row_count = PHANTOM_MARKERS;
    p->markers.row_start = p->starts;
    p->markers.nodes = p->nodes;
    p->markers.weights = p->weights;
    phantom_measure(p);
}

static void phantom_free(phantom *p)
{
    sb_body_destroy(p->body);
    sb_mesh_free(&p->mesh);
}

static sb_identify_def phantom_def(phantom *p, int count)
{
    sb_identify_def def = sb_default_identify_def();
    def.body = p->body;
    def.parameters = p->parameters;
    def.count = count;
    def.state_count = PHANTOM_STATES;
    def.measurements = p->seen;
    def.apply = phantom_apply;
    def.user = p;
    return def;
}

/* nu of the core is that of the shell here: the body is to have the true one. */
static void phantom_reset(phantom *p, double core, double shell)
{
    sb_material m = sb_material_neo_hookean(REAL(core), REAL(0.42), 1000);
    CHECK_OK(sb_body_set_region_material(p->body, 1, &m, NULL));
    m = sb_material_neo_hookean(REAL(shell), REAL(0.42), 1000);
    CHECK_OK(sb_body_set_region_material(p->body, 0, &m, NULL));
    sb_body_reset(p->body);
}

/* Bodies of more nodes than are factored for a few columns: those are iterated for, and factored for where that takes
 * long, as near incompressibility. */
static void test_large(void)
{
    static const double poissons[2] = {0.42, 0.49999};
    phantom *p = (phantom *)calloc(1, sizeof *p);
    if (!CHECK(p != NULL))
        return;
    phantom_make(p, 12, NULL);
    CHECK(p->mesh.node_count > 2000);
    for (int k = 0; k < (check_quick() || SB_REAL_IS_FLOAT ? 1 : 2); k++) {
        sb_identify_def def = phantom_def(p, 2);
        sb_material shell = sb_material_neo_hookean(4000, REAL(poissons[k]), 1000);
        sb_material core = sb_material_neo_hookean(12000, REAL(poissons[k]), 1000);
        sb_real values[2] = {2500, 8000}, deviations[2], shares[2];
        sb_identify_info info;
        sb_error error;
        def.state_count = 1;
        sb_body_reset(p->body);
        CHECK_OK(sb_body_set_region_material(p->body, 0, &shell, NULL));
        CHECK_OK(sb_body_set_region_material(p->body, 1, &core, NULL));
        for (int s = 0; s < PHANTOM_STATES; s++)
            p->depth[s] = 2e-4 * (s + 1);
        phantom_measure(p);
        if (!CHECK_OK(sb_identify(&def, values, deviations, shares, &info, &error)))
            printf("%s\n", error.message);
        CHECK_NEAR((double)values[0], 4000, scene_tolerance(1e-6, 1e5) * 4000);
        CHECK_NEAR((double)values[1], 12000, scene_tolerance(1e-6, 1e5) * 12000);
    }
    phantom_free(p);
    free(p);
}

/* Without noise the values come back exactly, from starts ten times off, one of them the wrong way round. */
static void test_recovery(void)
{
    static const double start[2][3] = {{1500, 1500, 0.3}, {40000, 1200, 0.35}};
    phantom p;
    phantom_make(&p, check_quick() ? 3 : 5, NULL);
    for (int k = 0; k < 2; k++) {
        sb_identify_def def = phantom_def(&p, 3);
        sb_real values[3] = {REAL(start[k][0]), REAL(start[k][1]), REAL(start[k][2])}, deviations[3], shares[3];
        sb_identify_info info;
        sb_error error;
        phantom_reset(&p, 12000, 4000);
        if (!CHECK_OK(sb_identify(&def, values, deviations, shares, &info, &error))) {
            printf("%s\n", error.message);
            continue;
        }
        printf(
            "  from %g, %g, %g: %d steps, %d solves, chi2 %.1e; deviations %.2g, %.2g, %.2g, shares %.2g, %.2g, %.2g\n",
            start[k][0], start[k][1], start[k][2], info.iterations, info.solves, info.chi2, (double)deviations[0],
            (double)deviations[1], (double)deviations[2], (double)shares[0], (double)shares[1], (double)shares[2]);
        CHECK_NEAR((double)values[0], 4000, scene_tolerance(1e-6, 1e5) * 4000);
        CHECK_NEAR((double)values[1], 12000, scene_tolerance(1e-6, 1e5) * 12000);
        CHECK_NEAR((double)values[2], 0.42, scene_tolerance(1e-6, 1e5));
        CHECK(info.warnings & SB_IDENTIFY_MISFIT); /* no noise at all is less than the sigmas say */
        CHECK(shares[0] > REAL(0.05) && shares[1] > REAL(0.05));
        CHECK(info.iterations <= 20);
    }
    phantom_free(&p);
}

/* A force curve alone does not tell core from shell, and says so; markers alone see no modulus at all. */
static void test_hidden(void)
{
    phantom p;
    sb_identify_def def;
    sb_real values[3], deviations[3], shares[3];
    sb_identify_info info;
    sb_error error;
    phantom_make(&p, 5, NULL);
    for (int s = 0; s < PHANTOM_STATES; s++)
        p.seen[s].rows = NULL;
    def = phantom_def(&p, 2);
    phantom_reset(&p, 12000, 4000);
    values[0] = 3000, values[1] = 15000;
    if (CHECK_OK(sb_identify(&def, values, deviations, shares, &info, &error))) {
        printf("  force alone: shares %.2g, %.2g, deviations %.2g, %.2g; hidden: %s\n", (double)shares[0],
               (double)shares[1], (double)(deviations[0] / values[0]), (double)(deviations[1] / values[1]),
               info.hidden);
        CHECK(info.weakest < REAL(0.1) && shares[0] < REAL(0.1));
        CHECK(strstr(info.hidden, "value 0 x 1.") && strstr(info.hidden, "value 1 x 0."));
    }
    for (int s = 0; s < PHANTOM_STATES; s++) {
        p.seen[s].rows = &p.markers;
        p.seen[s].force_count = 0;
    }
    phantom_reset(&p, 12000, 4000);
    values[0] = 3000, values[1] = 9000;
    CHECK_RESULT(sb_identify(&def, values, NULL, NULL, NULL, &error), SB_ERROR_INDEFINITE);
    printf("  markers alone: %s\n", error.message);
    CHECK(values[0] == 3000 && strstr(error.message, "value 0 x") && strstr(error.message, "value 1 x"));
    phantom_free(&p);
}

/* Deviations are those of values identified from noisy readings. */
static void test_deviations(void)
{
    const int runs = check_quick() ? 8 : 20; /* of 120 runs both deviations were met to 6 % */
    phantom p, noisy;
    unsigned long long seed = 23;
    double sum[2] = {0, 0}, squares[2] = {0, 0}, chi2 = 0;
    sb_real deviations[2], values[2];
    sb_identify_info info;
    sb_identify_def def;
    phantom_make(&p, 3, NULL);
    for (int run = 0; run < runs; run++) {
        noisy = p;
        for (int s = 0; s < PHANTOM_STATES; s++) {
            double draw[3 * PHANTOM_MARKERS + 3];
            for (int i = 0; i < 3 * PHANTOM_MARKERS + 3; i++)
                draw[i] = sqrt(-2 * log(1 - check_random(&seed))) * cos(6.283185307179586 * check_random(&seed));
            noisy.seen[s].points = noisy.points[s];
            noisy.seen[s].rows = &p.markers;
            for (int k = 0; k < PHANTOM_MARKERS; k++)
                noisy.points[s][k] = sb_v3_madd(p.points[s][k], p.seen[s].sigma_point,
                                                sb_v3(REAL(draw[3 * k]), REAL(draw[3 * k + 1]), REAL(draw[3 * k + 2])));
            for (int axis = 0; axis < 3; axis++)
                (&noisy.seen[s].force.x)[axis] += p.seen[s].sigma_force * REAL(draw[3 * PHANTOM_MARKERS + axis]);
        }
        def = phantom_def(&noisy, 2);
        phantom_reset(&p, 12000, 4000);
        values[0] = 4000, values[1] = 12000;
        CHECK_OK(sb_identify(&def, values, deviations, NULL, &info, NULL));
        chi2 += info.chi2 / (info.readings - 2) / runs;
        for (int k = 0; k < 2; k++) {
            double off = (double)values[k] / (k ? 12000 : 4000) - 1;
            sum[k] += off / runs;
            squares[k] += off * off / runs;
        }
    }
    for (int k = 0; k < 2; k++) {
        double spread = sqrt(squares[k] - sum[k] * sum[k]), said = (double)deviations[k] / (k ? 12000 : 4000);
        printf("  value %d: deviation %.4f, of %d runs %.4f\n", k, said, runs, spread);
        CHECK_NEAR(spread, said, (check_quick() ? 0.7 : 0.45) * said);
    }
    CHECK_NEAR(chi2, 1, 0.2);
    phantom_free(&p);
}

/* A free value: how deep the tool went, of which only `apply` knows. */
static sb_result phantom_apply_deep(void *user, int state, const sb_real *free_values, sb_body *body, sb_error *error)
{
    phantom *p = (phantom *)user;
    sb_vec3 down = sb_v3(0, 0, REAL(-p->depth[state]) * free_values[0]);
    (void)error;
    return sb_body_prescribe(body, p->top, p->top_count, SB_XYZ, &down, 1);
}

static void test_free_value(void)
{
    phantom p;
    sb_identify_def def;
    sb_real values[3] = {3000, 9000, REAL(0.8)};
    sb_error error;
    phantom_make(&p, 3, NULL);
    def = phantom_def(&p, 2);
    def.free_count = 1;
    def.apply = phantom_apply_deep;
    phantom_reset(&p, 12000, 4000);
    if (!CHECK_OK(sb_identify(&def, values, NULL, NULL, NULL, &error)))
        printf("%s\n", error.message);
    CHECK_NEAR((double)values[0], 4000, scene_tolerance(1e-5, 1e5) * 4000);
    CHECK_NEAR((double)values[1], 12000, scene_tolerance(1e-5, 1e5) * 12000);
    CHECK_NEAR((double)values[2], 1, scene_tolerance(1e-5, 1e5));
    phantom_free(&p);
}

/* Constants of an isochoric material, density and gravity's loads, with bounds. */
static void test_constants(void)
{
    sb_mesh mesh = scene_box(SB_TET10, 4, 1, 1, sb_v3(REAL(0.1), REAL(0.02), REAL(0.02)), 0.1);
    sb_body_def body_def = sb_default_body_def();
    sb_identify_def def = sb_default_identify_def();
    sb_parameter p[2];
    sb_measurement seen;
    sb_vec3 points[3];
    sb_real values[2] = {300, 800}, low[2] = {1, 1}, high[2] = {550, 900};
    const sb_real weights[3] = {1, 1, 1};
    int starts[4] = {0, 1, 2, 3}, nodes[3];
    sb_mapping rows;
    sb_identify_info info;
    sb_static_options options = sb_default_static_options();
    options.tolerance = SB_REAL_IS_FLOAT ? REAL(1e-5) : REAL(1e-11);
    body_def.mesh = &mesh;
    body_def.material = sb_material_neo_hookean_isochoric(600, REAL(4e-4), 1000);
    body_def.gravity = sb_v3(0, 0, -1);
    def.body = scene_body(&body_def);
    scene_fix_plane(def.body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_solve_static(def.body, &options, NULL));
    for (int k = 0; k < 3; k++)
        nodes[k] = mesh.node_count - 1 - 5 * k;
    rows.row_count = 3, rows.row_start = starts, rows.nodes = nodes, rows.weights = weights;
    memset(&seen, 0, sizeof seen);
    sb_mapping_apply(&rows, sb_body_positions(def.body), points);
    seen.rows = &rows, seen.points = points, seen.sigma_point = REAL(1e-4);
    memset(p, 0, sizeof p);
    p[0].kind = SB_PARAMETER_CONSTANT, p[0].constant = SB_CONSTANT_C10;
    p[1].kind = SB_PARAMETER_DENSITY;
    def.parameters = p, def.count = 1, def.measurements = &seen;
    CHECK_OK(sb_identify(&def, values, NULL, NULL, NULL, NULL));
    CHECK_NEAR((double)values[0], 600, scene_tolerance(1e-5, 1e6) * 600);
    values[0] = 300;
    def.low = low, def.high = high; /* it cannot come to 600 */
    CHECK_OK(sb_identify(&def, values, NULL, NULL, &info, NULL));
    CHECK((info.warnings & SB_IDENTIFY_BOUND) && values[0] == high[0]);
    def.low = def.high = NULL;
    def.count = 2; /* weights and all moduli by the same factor move nothing */
    p[0].kind = SB_PARAMETER_YOUNG, values[0] = 3000;
    CHECK_RESULT(sb_identify(&def, values, NULL, NULL, &info, NULL), SB_ERROR_INDEFINITE);
    sb_body_destroy(def.body);
    sb_mesh_free(&mesh);
}

/* With one modulus at a bound the other is what is best with it there: the same as when it alone is sought. */
static void test_bounds(void)
{
    static const double ends[4] = {3700, 4300, 10000, 14000}; /* above, below the shell's; above, below the core's */
    phantom p;
    phantom_make(&p, 3, NULL);
    for (int k = 0; k < 4; k += check_quick() ? 3 : 1) {
        int at = k / 2, below = k % 2;
        double start = below ? 1.2 * ends[k] : 0.7 * ends[k];
        sb_real low[2] = {1, 1}, high[2] = {REAL(1e9), REAL(1e9)};
        sb_real both[2] = {REAL(at ? 1500 : start), REAL(at ? start : 1500)}, alone = 5000;
        sb_identify_def def = phantom_def(&p, 2);
        sb_identify_info info, other;
        sb_error error;
        (below ? low : high)[at] = REAL(ends[k]);
        def.low = low, def.high = high;
        phantom_reset(&p, 12000, 4000);
        if (!CHECK_OK(sb_identify(&def, both, NULL, NULL, &info, &error)))
            printf("%s\n", error.message);
        CHECK(both[at] == REAL(ends[k]) && (info.warnings & SB_IDENTIFY_BOUND));
        phantom_reset(&p, at ? ends[k] : 12000, at ? 4000 : ends[k]);
        def.low = def.high = NULL;
        def.count = 1;
        def.parameters = p.parameters + 1 - at;
        CHECK_OK(sb_identify(&def, &alone, NULL, NULL, &other, NULL));
        CHECK_NEAR((double)both[1 - at], (double)alone, scene_tolerance(1e-3, 1e5) * (double)alone);
        CHECK_NEAR(info.chi2, other.chi2, scene_tolerance(1e-5, 1e4) * other.chi2);
    }
    phantom_free(&p);
}

/* What a body is before and after: what loads do to it. */
static unsigned long long phantom_answer(phantom *p)
{
    sb_body_reset(p->body);
    CHECK_OK(phantom_apply(p, 0, NULL, p->body, NULL));
    CHECK_OK(sb_body_solve_static(p->body, NULL, NULL));
    return scene_hash(sb_body_positions(p->body), (size_t)p->mesh.node_count * sizeof(sb_vec3));
}

/* Loads that are sought: none is left of them on failure, and forces are not added twice. */
static void test_loads(void)
{
    const sb_real pressure = 100, stiffness[2] = {3, 5};
    const sb_vec3 push = sb_v3(REAL(0.02), 0, 0);
    phantom p;
    sb_identify_def def;
    sb_parameter sought[4];
    sb_real start[4] = {REAL(0.002), REAL(-0.3), 30, 2}, values[4];
    sb_error error;
    const int corners[4] = {0, 4, 7, 3}; /* a face at x = 0 */
    int side[2], face[4], found = 0, load, springs;
    unsigned long long before;
    phantom_make(&p, 3, NULL);
    for (int a = 0; a < 4; a++)
        face[a] = p.mesh.elements[corners[a]];
    for (int i = 0; i < p.mesh.node_count && found < 2; i++)
        if (p.mesh.nodes[i].x <= 0 && p.mesh.nodes[i].z > REAL(0.02))
            side[found++] = i;
    CHECK_OK(sb_body_add_pressure(p.body, face, 1, 4, pressure, &load, NULL));
    CHECK_OK(sb_body_add_springs(p.body, side, 2, stiffness, 0, p.mesh.nodes, &springs, NULL));
    CHECK_OK(sb_body_add_forces(p.body, side, 1, &push, 1));
    phantom_measure(&p);
    sb_body_clear_loads(p.body);
    before = phantom_answer(&p);
    memset(sought, 0, sizeof sought);
    sought[0].kind = SB_PARAMETER_FORCE, sought[0].nodes = side, sought[0].node_count = 1;
    sought[1].kind = SB_PARAMETER_GRAVITY, sought[1].axis = 2;
    sought[2].kind = SB_PARAMETER_PRESSURE, sought[2].load_id = load;
    sought[3].kind = SB_PARAMETER_STIFFNESS, sought[3].load_id = springs, sought[3].row = SB_AUTO;
    def = phantom_def(&p, 4);
    def.parameters = sought;
    def.max_iterations = 1;
    memcpy(values, start, sizeof values);
    CHECK_RESULT(sb_identify(&def, values, NULL, NULL, NULL, &error), SB_ERROR_NOT_CONVERGED);
    CHECK(phantom_answer(&p) == before && memcmp(values, start, sizeof values) == 0);
    def.max_iterations = 50;
    def.count = 3;
    if (!CHECK_OK(sb_identify(&def, values, NULL, NULL, NULL, &error)))
        printf("%s\n", error.message);
    CHECK_NEAR((double)values[0], 0.02, scene_tolerance(1e-6, 1e5) * 0.02);
    CHECK_NEAR((double)values[1], 0, scene_tolerance(1e-4, 1e5));
    CHECK_NEAR((double)values[2], 100, scene_tolerance(1e-4, 1e5) * 100);
    phantom_free(&p);
}

/* Correlations are those of the deviations, and the direction in numbers is the one in words. */
static void test_numbers(void)
{
    phantom p;
    sb_identify_def def;
    sb_real values[3] = {3000, 9000, REAL(0.35)}, deviations[3], shares[3], c[9], d[3];
    sb_identify_info info;
    char words[160];
    phantom_make(&p, 3, NULL);
    def = phantom_def(&p, 2);
    def.correlations = c;
    def.direction = d;
    phantom_reset(&p, 12000, 4000);
    CHECK_OK(sb_identify(&def, values, deviations, shares, &info, NULL));
    CHECK(c[0] == 1 && c[3] == 1 && c[1] == c[2]);
    CHECK_NEAR((double)(c[1] * c[1]), 1 - (double)shares[0], scene_tolerance(1e-9, 1e5)); /* of two values */
    CHECK_NEAR((double)shares[0], (double)shares[1], scene_tolerance(1e-9, 1e5));
    snprintf(words, sizeof words, "value 0 x %.3g, value 1 x %.3g", exp((double)d[0] / (double)values[0]),
             exp((double)d[1] / (double)values[1]));
    if (!CHECK(strcmp(words, info.hidden) == 0))
        printf("%s, and %s\n", words, info.hidden);
    def = phantom_def(&p, 3);
    def.correlations = c;
    phantom_reset(&p, 12000, 4000);
    CHECK_OK(sb_identify(&def, values, deviations, shares, &info, NULL));
    for (int k = 0; k < 3; k++)
        for (int j = 0; j < 3; j++)
            CHECK(c[3 * k + j] == c[3 * j + k] && c[3 * k + j] >= -1 && c[3 * k + j] <= 1);
    phantom_free(&p);
}

/* A free value is never tried beyond its bounds, not for differences either. */
typedef struct watched {
    phantom *p;
    sb_real least, most;
} watched;

static sb_result phantom_apply_watched(void *user, int state, const sb_real *free_values, sb_body *body,
                                       sb_error *error)
{
    watched *w = (watched *)user;
    w->least = sb_min(w->least, free_values[0]);
    w->most = sb_max(w->most, free_values[0]);
    return phantom_apply_deep(w->p, state, free_values, body, error);
}

static void test_free_bounds(void)
{
    const sb_real low = REAL(0.7), high = REAL(0.95);
    phantom p;
    watched w;
    sb_identify_def def;
    sb_identify_info info;
    sb_real value = low;
    phantom_make(&p, 3, NULL);
    w.p = &p, w.least = 9, w.most = 0;
    def = phantom_def(&p, 0);
    def.free_count = 1;
    def.low = &low, def.high = &high;
    def.apply = phantom_apply_watched;
    def.user = &w;
    CHECK_OK(sb_identify(&def, &value, NULL, NULL, &info, NULL));
    CHECK(value == high && (info.warnings & SB_IDENTIFY_BOUND));
    CHECK(w.least == low && w.most == high);
    phantom_free(&p);
}

static void refuse(sb_identify_def def, double first, sb_result expected)
{
    sb_real values[3] = {REAL(first), 9000, REAL(0.4)};
    sb_error error;
    memset(&error, 0, sizeof error);
    CHECK_RESULT(sb_identify(&def, values, NULL, NULL, NULL, &error), expected);
    CHECK_RESULT(error.result, expected);
    CHECK(error.message[0] != 0 && values[1] == 9000);
}

static void test_refused(void)
{
    phantom p;
    sb_identify_def good, def;
    const sb_real low[3] = {3500, 1, 0};
    sb_vec3 *before;
    phantom_make(&p, 3, NULL);
    good = phantom_def(&p, 2);
    refuse(good, -1, SB_ERROR_ARGUMENT);
    refuse(good, (double)NAN, SB_ERROR_ARGUMENT);
    def = good, def.low = low, refuse(def, 3000, SB_ERROR_ARGUMENT);
    def = good, def.cookie = 0, refuse(def, 3000, SB_ERROR_ARGUMENT);
    def = good, def.apply = NULL, refuse(def, 3000, SB_ERROR_ARGUMENT);
    def = good, def.count = 0, refuse(def, 3000, SB_ERROR_ARGUMENT);
    p.parameters[1] = p.parameters[0], refuse(good, 3000, SB_ERROR_ARGUMENT), phantom_name(&p);
    p.parameters[1].kind = SB_PARAMETER_SUPPORT, p.parameters[1].nodes = p.top, p.parameters[1].node_count = 1;
    refuse(good, 3000, SB_ERROR_UNSUPPORTED), phantom_name(&p);
    p.parameters[1].region = 3, refuse(good, 3000, SB_ERROR_INDEX), phantom_name(&p);
    p.seen[1].sigma_point = 0, refuse(good, 3000, SB_ERROR_ARGUMENT), p.seen[1].sigma_point = REAL(1e-4);
    p.nodes[2] += 1000000, refuse(good, 3000, SB_ERROR_INDEX), p.nodes[2] -= 1000000;
    def = good, def.max_iterations = 1, refuse(def, 30, SB_ERROR_NOT_CONVERGED);
    before = (sb_vec3 *)malloc((size_t)p.mesh.node_count * sizeof *before);
    memcpy(before, sb_body_displacements(p.body), (size_t)p.mesh.node_count * sizeof *before);
    p.answer = SB_ERROR_FILE;
    refuse(good, 3000, SB_ERROR_FILE);
    CHECK(memcmp(before, sb_body_displacements(p.body), (size_t)p.mesh.node_count * sizeof *before) == 0);
    free(before);
    phantom_free(&p);
}

/* Some of the allocations fail: an error, or conjugate gradients in place of a factor. */
static void test_without_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    phantom p;
    sb_identify_def def;
    int calls, live;
    phantom_make(&p, 3, &allocator);
    def = phantom_def(&p, 1);
    for (int k = 0; k < 7; k++) {
        sb_real value = 3000;
        sb_result result;
        phantom_reset(&p, 12000, 4000);
        live = memory.live;
        calls = memory.calls;
        memory.fail_at = k ? calls + k : 0;
        result = sb_identify(&def, &value, NULL, NULL, NULL, NULL);
        memory.fail_at = 0;
        CHECK_INT(memory.live, live);
        if (result == SB_OK)
            CHECK_NEAR((double)value, 4000, scene_tolerance(1e-5, 1e5) * 4000);
        else
            CHECK(result == SB_ERROR_MEMORY && value == 3000);
    }
    phantom_free(&p);
}

CHECK_SUITE(identify, {"recovery", test_recovery}, {"large", test_large}, {"hidden", test_hidden},
            {"deviations", test_deviations}, {"free value", test_free_value}, {"constants", test_constants},
            {"bounds", test_bounds}, {"loads", test_loads}, {"numbers", test_numbers},
            {"free value's bounds", test_free_bounds}, {"refused", test_refused},
            {"without memory", test_without_memory});
