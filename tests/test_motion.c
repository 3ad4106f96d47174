/* test_motion: gradients of recorded motions against central differences of motions that are run anew, for all kinds of
 * parameters, where the motion began and forces of single steps; and what is refused. */
#include "random_case.h"
#include "scene.h"

enum { MOTION_STEPS = 11, MOTION_NODE = 1 };

/* What is changed a little, to see what the loss makes of it. */
typedef enum motion_change {
    OF_NOTHING,
    OF_YOUNG,
    OF_POISSON,
    OF_CONSTANT,
    OF_DENSITY,
    OF_GRAVITY,
    OF_FORCE,
    OF_PRESSURE,
    OF_STIFFNESS,
    OF_TARGET,
    OF_PLACE,
    OF_SPEED,
    OF_PUSH /* a force in one step */
} motion_change;

typedef struct motion_case {
    sb_element_type type;
    int model;
    sb_mass_kind mass;
    int constrained;
    sb_real alpha, beta;
} motion_case;

typedef struct motion {
    const motion_case *of;
    sb_mesh mesh;
    sb_body *body;
    int pressure, spring, high[64], high_count;
} motion;

enum { PUSHED = 6 }; /* the step of OF_PUSH */

static sb_material motion_material(int model, double young, double nu, double mu_more, double density)
{
    sb_material m;
    switch (model) {
    case 0: m = sb_material_linear(REAL(young), REAL(nu), REAL(density)); break;
    case 1: m = sb_material_corotated(REAL(young), REAL(nu), REAL(density)); break;
    case 2: m = sb_material_neo_hookean(REAL(young), REAL(nu), REAL(density)); break;
    default: m = sb_material_stable_neo_hookean(REAL(young), REAL(nu), REAL(density));
    }
    m.mu += REAL(mu_more);
    return m;
}

static sb_vec3 motion_seen(int step, int node)
{
    return sb_v3(REAL(0.01 * sin(step + node)), REAL(0.02 * cos(2.0 * step - node)), REAL(-0.01 * sin(0.5 * node)));
}

static sb_real motion_length(int step) { return REAL(0.01 + 0.004 * (step % 3)); }

static void motion_loads(motion *m, motion_change change, double h)
{
    const sb_real k = REAL(25 + (change == OF_STIFFNESS ? h : 0));
    const sb_vec3 to = sb_v3(REAL(1.2 + (change == OF_TARGET ? h : 0)), REAL(0.3), REAL(0.1));
    const sb_vec3 force = sb_v3(REAL(0.5), REAL(-1), REAL(1.5 + (change == OF_FORCE ? h : 0)));
    int face[4], corners = sb_element_straight(m->mesh.element_type) == SB_TET4 ? 3 : 4;
    sb_boundary boundary;
    CHECK_OK(sb_body_add_springs(m->body, &m->high[1], 1, &k, 1, &to, &m->spring, NULL));
    CHECK_OK(sb_body_add_forces(m->body, m->high, 2, &force, 1));
    if (CHECK_OK(sb_mesh_boundary(&m->mesh, 0, NULL, &boundary, NULL))) {
        const sb_mesh *faces = &boundary.surface;
        int low = 0;
        for (int f = 0; f < faces->element_count && !low; f++) { /* one on top: its rim is open */
            low = 1;
            for (int c = 0; c < corners; c++) {
                face[c] = faces->elements[f * sb_mesh_element_width(faces) + c];
                low = low && m->mesh.nodes[face[c]].z > REAL(0.499);
            }
        }
        CHECK(low);
        CHECK_OK(sb_body_add_pressure(m->body, face, 1, corners, REAL(200 + (change == OF_PRESSURE ? h : 0)),
                                      &m->pressure, NULL));
        sb_boundary_free(&boundary);
    }
}

static void motion_tie(motion *m)
{
    const sb_constraint_term terms[5] = {{m->high[0], 0, 1},
                                         {m->high[1], 0, -1},
                                         {m->high[2], 1, 1},
                                         {m->high[3], 1, REAL(-0.5)},
                                         {m->high[1], 2, REAL(0.3)}};
    const int counts[2] = {2, 3};
    const sb_real values[2] = {0, REAL(0.005)};
    CHECK_OK(sb_body_add_constraints(m->body, terms, counts, values, 2, NULL, NULL));
}

/* The body before its first step: a box of so many cells each way, twice as many along x. */
static motion motion_make_of(const motion_case *of, motion_change change, double h, int cells, sb_jobs jobs)
{
    motion m;
    sb_body_def def = sb_default_body_def();
    int nodes;
    memset(&m, 0, sizeof m);
    m.of = of;
    m.mesh = scene_box(of->type, 2 * cells, cells, cells, sb_v3(1, REAL(0.5), REAL(0.5)), 0.1);
    for (int i = 0; i < m.mesh.node_count; i++)
        if (m.mesh.nodes[i].x > REAL(1 - 1e-6) && m.high_count < 64)
            m.high[m.high_count++] = i;
    def.mesh = &m.mesh;
    def.jobs = jobs;
    def.material = motion_material(of->model, 5000 + (change == OF_YOUNG ? h : 0), 0.3 + (change == OF_POISSON ? h : 0),
                                   change == OF_CONSTANT ? h : 0, 1000 + (change == OF_DENSITY ? h : 0));
    def.mass = of->mass;
    def.max_newton = 60;
    def.newton_tolerance = REAL(sizeof(sb_real) == 8 ? 1e-13 : 1e-6);
    def.tolerance = REAL(sizeof(sb_real) == 8 ? 1e-13 : 1e-6);
    def.damping_mass = of->alpha;
    def.damping_stiffness = of->beta;
    def.gravity = sb_v3(REAL(0.5), REAL(-0.2), REAL(-6 + (change == OF_GRAVITY ? h : 0)));
    m.body = scene_body(&def);
    scene_fix_plane(m.body, &m.mesh, 0, 0, SB_XYZ);
    motion_loads(&m, change, h);
    if (of->constrained)
        motion_tie(&m);
    nodes = sb_body_node_count(m.body);
    if (!of->constrained) { /* where it begins, and how fast */
        sb_vec3 *u = (sb_vec3 *)calloc((size_t)nodes, sizeof *u), *v = (sb_vec3 *)calloc((size_t)nodes, sizeof *v);
        for (int i = 0; i < nodes; i++) {
            u[i] = sb_v3_scale(REAL(0.02), sb_v3(m.mesh.nodes[i].x, 0, 0));
            v[i] = sb_v3(0, REAL(0.3) * m.mesh.nodes[i].x, 0);
        }
        u[m.high[MOTION_NODE]].z += REAL(change == OF_PLACE ? h : 0);
        v[m.high[MOTION_NODE]].z += REAL(change == OF_SPEED ? h : 0);
        CHECK_OK(sb_body_set_displacements(m.body, u));
        CHECK_OK(sb_body_set_velocities(m.body, v));
        free(u);
        free(v);
    }
    return m;
}

static motion motion_make(const motion_case *of, motion_change change, double h)
{
    return motion_make_of(of, change, h, 1, sb_default_body_def().jobs);
}

static void motion_free(motion *m)
{
    sb_body_destroy(m->body);
    sb_mesh_free(&m->mesh);
}

/* A part of the loss: squares of what all nodes miss. */
static double motion_loss_of(const motion *m, int step)
{
    const sb_vec3 *u = sb_body_displacements(m->body);
    double sum = 0;
    for (int i = 0; i < sb_body_node_count(m->body); i++) {
        sb_vec3 miss = sb_v3_sub(u[i], motion_seen(step, i));
        sum += 0.5 * (double)sb_v3_dot(miss, miss);
    }
    return sum;
}

static void motion_slope_of(void *user, int step, const sb_vec3 *u, sb_vec3 *dj_du)
{
    const motion *m = (const motion *)user;
    for (int i = 0; i < m->mesh.node_count; i++)
        dj_du[i] = sb_v3_sub(u[i], motion_seen(step, i));
}

static sb_recording_loss motion_loss(motion *m)
{
    sb_recording_loss loss;
    loss.add_slope = motion_slope_of;
    loss.user = m;
    return loss;
}

/* Runs it: pressures and supports change on the way. The loss of all steps. */
static double motion_run(motion *m, motion_change change, double h)
{
    const sb_vec3 push = sb_v3(0, REAL(h), 0), back = sb_v3(0, REAL(-h), 0);
    double loss = 0;
    for (int step = 0; step < MOTION_STEPS; step++) {
        if (step == 4)
            CHECK_OK(sb_body_set_pressure(m->body, m->pressure, REAL(320 + (change == OF_PRESSURE ? h : 0))));
        if (step == 5) {
            sb_vec3 to = sb_v3(0, 0, REAL(0.01));
            int low = 0;
            CHECK_OK(sb_body_prescribe(m->body, &low, 1, SB_Z, &to, 1));
        }
        if (step == PUSHED && change == OF_PUSH)
            CHECK_OK(sb_body_add_forces(m->body, &m->high[MOTION_NODE], 1, &push, 1));
        CHECK_OK(sb_body_step(m->body, motion_length(step), NULL));
        loss += motion_loss_of(m, step);
        if (step == PUSHED && change == OF_PUSH)
            CHECK_OK(sb_body_add_forces(m->body, &m->high[MOTION_NODE], 1, &back, 1));
    }
    return loss;
}

static double motion_again(const motion_case *of, motion_change change, double h)
{
    motion m = motion_make(of, change, h);
    double loss = motion_run(&m, change, h);
    motion_free(&m);
    return loss;
}

static sb_recording *motion_record(motion *m)
{
    sb_recording *recording = NULL;
    CHECK_OK(sb_recording_start(m->body, 0, NULL, &recording, NULL));
    motion_run(m, OF_NOTHING, 0);
    sb_recording_stop(recording);
    return recording;
}

/* Parameters in the order of changes from OF_YOUNG on. */
enum { MOTION_PARAMETERS = 9 };
static void motion_parameters(const motion *m, sb_parameter p[MOTION_PARAMETERS])
{
    static const sb_parameter_kind kinds[MOTION_PARAMETERS] = {
        SB_PARAMETER_YOUNG, SB_PARAMETER_POISSON,  SB_PARAMETER_CONSTANT,  SB_PARAMETER_DENSITY, SB_PARAMETER_GRAVITY,
        SB_PARAMETER_FORCE, SB_PARAMETER_PRESSURE, SB_PARAMETER_STIFFNESS, SB_PARAMETER_TARGET};
    memset(p, 0, MOTION_PARAMETERS * sizeof *p);
    for (int k = 0; k < MOTION_PARAMETERS; k++) {
        p[k].kind = kinds[k];
        p[k].constant = SB_CONSTANT_MU;
        p[k].axis = kinds[k] == SB_PARAMETER_TARGET ? 0 : 2;
        p[k].load_id = kinds[k] == SB_PARAMETER_PRESSURE ? m->pressure : m->spring;
        p[k].row = SB_AUTO;
        p[k].nodes = m->high;
        p[k].node_count = 2;
    }
}

static const double motion_widths[OF_PUSH + 1] = {0, 5, 1e-4, 2, 1, 1e-3, 1e-3, 0.5, 0.05, 1e-3, 1e-4, 1e-4, 1e-3};

/* By differences of fourth order. */
static double motion_difference(const motion_case *of, motion_change change)
{
    double h = motion_widths[change];
    double near = motion_again(of, change, h) - motion_again(of, change, -h);
    double far = motion_again(of, change, 2 * h) - motion_again(of, change, -2 * h);
    return (8 * near - far) / (12 * h);
}

static void motion_compare(const motion_case *of, const char *name)
{
    motion m = motion_make(of, OF_NOTHING, 0);
    sb_recording *recording = motion_record(&m);
    size_t nodes = (size_t)sb_body_node_count(m.body);
    sb_vec3 *vectors = (sb_vec3 *)malloc((2 + MOTION_STEPS) * nodes * sizeof *vectors);
    sb_parameter parameters[MOTION_PARAMETERS];
    sb_real gradient[MOTION_PARAMETERS];
    sb_recording_loss loss = motion_loss(&m);
    sb_recording_slopes slopes;
    uint64_t end = sb_body_state_hash(m.body);
    sb_error error;
    double worst = 0;
    memset(&error, 0, sizeof error);
    slopes.gradient = gradient;
    slopes.displacement = vectors;
    slopes.velocity = vectors + nodes;
    slopes.force = vectors + 2 * nodes;
    motion_parameters(&m, parameters);
    if (!CHECK_OK(sb_recording_gradient(recording, m.body, &loss, parameters, MOTION_PARAMETERS, &slopes, &error)))
        printf("%s: %s\n", name, error.message);
    CHECK(sb_body_state_hash(m.body) == end);
    for (int k = OF_YOUNG; k <= OF_PUSH; k++) {
        motion_change change = (motion_change)k;
        sb_vec3 at;
        double slope, expected;
        if ((change == OF_CONSTANT && of->model == 3) ||
            (of->constrained && (change == OF_PLACE || change == OF_SPEED)))
            continue; /* lambda of a stable law follows mu in another way than a change of the field */
        at = change == OF_PLACE   ? slopes.displacement[m.high[MOTION_NODE]]
             : change == OF_SPEED ? slopes.velocity[m.high[MOTION_NODE]]
             : change == OF_PUSH  ? slopes.force[(size_t)PUSHED * nodes + (size_t)m.high[MOTION_NODE]]
                                  : sb_v3(0, 0, 0);
        slope = k < OF_PLACE ? (double)gradient[k - OF_YOUNG] : (double)(change == OF_PUSH ? at.y : at.z);
        expected = motion_difference(of, change);
        CHECK_NEAR(slope, expected, 1e-7 * fabs(expected));
        worst = fmax(worst, fabs(slope - expected) / fabs(expected));
    }
    printf("  %-28s off by %.1e of differences\n", name, worst);
    free(vectors);
    sb_recording_destroy(recording);
    motion_free(&m);
}

static void test_gradients(void)
{
    static const motion_case cases[] = {
        {SB_TET4, 0, SB_MASS_LUMPED, 0, REAL(0.5), 0}, {SB_TET4, 0, SB_MASS_LUMPED, 0, REAL(0.5), REAL(0.01)},
        {SB_TET4, 1, SB_MASS_LUMPED, 0, 2, 0},         {SB_HEX8, 2, SB_MASS_CONSISTENT, 0, REAL(0.7), 0},
        {SB_TET10, 3, SB_MASS_LUMPED, 0, 0, 0},        {SB_HEX20, 1, SB_MASS_CONSISTENT, 0, 1, 0},
        {SB_TET4, 2, SB_MASS_LUMPED, 1, REAL(0.5), 0}, {SB_HEX8, 0, SB_MASS_CONSISTENT, 1, REAL(0.5), REAL(0.02)}};
    static const char *const names[] = {"tet4, linear",      "tet4, linear, damped", "tet4, corotated",
                                        "hex8, neo-Hookean", "tet10, stable",        "hex20, corotated",
                                        "tet4, tied",        "hex8, tied and damped"};
    if (sizeof(sb_real) != sizeof(double)) {
        CHECK_SKIP("differences need double precision");
        return;
    }
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++)
        motion_compare(cases + i, names[i]);
}

/* ---- the rest ---------------------------------------------------------------------------------------------------- */

static const motion_case plain_case = {SB_TET4, 1, SB_MASS_LUMPED, 0, 1, 0};

/* The gradient by the parameters, and what the body is after it. */
static sb_result motion_gradient(motion *m, const sb_recording *recording, const sb_parameter *p, int count,
                                 sb_real *gradient, sb_error *error)
{
    sb_recording_loss loss = motion_loss(m);
    sb_recording_slopes slopes;
    memset(&slopes, 0, sizeof slopes);
    slopes.gradient = gradient;
    return sb_recording_gradient(recording, m->body, &loss, p, count, &slopes, error);
}

/* A saved recording on a body that has gone elsewhere gives the same bits. */
static void test_same_bits(void)
{
    motion m = motion_make(&plain_case, OF_NOTHING, 0);
    sb_recording *recording = motion_record(&m), *loaded = NULL;
    sb_parameter parameters[MOTION_PARAMETERS];
    sb_real first[MOTION_PARAMETERS], again[MOTION_PARAMETERS];
    uint64_t end = sb_body_state_hash(m.body);
    size_t size = sb_recording_get_info(recording).bytes;
    unsigned char *image = (unsigned char *)malloc(size);
    motion_parameters(&m, parameters);
    CHECK_OK(motion_gradient(&m, recording, parameters, MOTION_PARAMETERS, first, NULL));
    CHECK_OK(sb_recording_save(recording, image, size));
    CHECK_OK(sb_recording_load(image, size, NULL, &loaded, NULL));
    CHECK_OK(sb_body_step(m.body, REAL(0.02), NULL));
    CHECK_OK(motion_gradient(&m, loaded, parameters, MOTION_PARAMETERS, again, NULL));
    CHECK(memcmp(first, again, sizeof first) == 0);
    CHECK(sb_body_state_hash(m.body) == end);
    free(image);
    sb_recording_destroy(loaded);
    sb_recording_destroy(recording);
    motion_free(&m);
}

/* Nor do threads change any, of the motion nor of its slopes. */
static void test_threads(void)
{
    static const int numbers[] = {1, 2, 3, 7};
    sb_real first[MOTION_PARAMETERS], again[MOTION_PARAMETERS];
    for (int i = 0; i < (int)(sizeof numbers / sizeof numbers[0]); i++) {
        int workers = numbers[i];
        motion m = motion_make_of(&plain_case, OF_NOTHING, 0, 5, scene_jobs(&workers));
        sb_recording *recording = motion_record(&m);
        sb_parameter parameters[MOTION_PARAMETERS];
        motion_parameters(&m, parameters);
        CHECK_OK(motion_gradient(&m, recording, parameters, MOTION_PARAMETERS, i ? again : first, NULL));
        CHECK(i == 0 || memcmp(first, again, sizeof first) == 0);
        sb_recording_destroy(recording);
        motion_free(&m);
    }
}

/* Refused with this result and words, and the body is what it was. */
static void check_refused(motion *m, const sb_recording *recording, const sb_parameter *p, sb_result expected,
                          const char *words)
{
    sb_error error;
    sb_real gradient = 77;
    uint64_t before = sb_body_state_hash(m->body);
    memset(&error, 0, sizeof error);
    CHECK_RESULT(motion_gradient(m, recording, p, p ? 1 : 0, &gradient, &error), expected);
    if (!CHECK(strstr(error.message, words) != NULL))
        printf("it says: %s\n", error.message);
    CHECK(gradient == 77);
    CHECK(sb_body_state_hash(m->body) == before);
}

static void test_refused_parameters(void)
{
    motion m = motion_make(&plain_case, OF_NOTHING, 0);
    sb_recording *recording = motion_record(&m), *listening = NULL;
    sb_parameter p;
    memset(&p, 0, sizeof p);
    p.kind = SB_PARAMETER_SUPPORT;
    check_refused(&m, recording, &p, SB_ERROR_UNSUPPORTED, "parameter 0: supports");
    p.kind = SB_PARAMETER_PRESSURE;
    p.load_id = 99;
    check_refused(&m, recording, &p, SB_ERROR_INDEX, "no pressure 99");
    p.kind = SB_PARAMETER_YOUNG;
    p.region = 5;
    check_refused(&m, recording, &p, SB_ERROR_INDEX, "no region 5");
    p.kind = (sb_parameter_kind)0;
    check_refused(&m, recording, &p, SB_ERROR_ARGUMENT, "no kind 0");
    CHECK_OK(sb_recording_start(m.body, 0, NULL, &listening, NULL));
    check_refused(&m, recording, NULL, SB_ERROR_ARGUMENT, "listens");
    sb_recording_destroy(listening);
    sb_recording_destroy(recording);
    motion_free(&m);
}

/* A recording of two steps of a body like this, with something in between. */
static void check_refused_motion(const sb_body_def *given, void (*between)(sb_body *body), sb_result expected,
                                 const char *words)
{
    motion m;
    sb_recording *recording = NULL;
    sb_body_def def = *given;
    memset(&m, 0, sizeof m);
    m.mesh = scene_box(SB_TET4, 2, 1, 1, sb_v3(1, REAL(0.5), REAL(0.5)), 0);
    def.mesh = &m.mesh;
    m.body = scene_body(&def);
    scene_fix_plane(m.body, &m.mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_recording_start(m.body, 0, NULL, &recording, NULL));
    CHECK_OK(sb_body_step(m.body, REAL(0.01), NULL));
    if (between)
        between(m.body);
    CHECK_OK(sb_body_step(m.body, REAL(0.01), NULL));
    sb_recording_stop(recording);
    if (expected == SB_OK)
        CHECK_OK(motion_gradient(&m, recording, NULL, 0, NULL, NULL));
    else
        check_refused(&m, recording, NULL, expected, words);
    sb_recording_destroy(recording);
    motion_free(&m);
}

static void between_reset(sb_body *body) { sb_body_reset(body); }
static void between_rest(sb_body *body) { CHECK_OK(sb_body_solve_static(body, NULL, NULL)); }
static void between_speed(sb_body *body)
{
    sb_vec3 *v = (sb_vec3 *)calloc((size_t)sb_body_node_count(body), sizeof *v);
    CHECK_OK(sb_body_set_velocities(body, v));
    free(v);
}

static void test_refused_motions(void)
{
    const sb_real g = REAL(0.3), tau = REAL(0.5);
    sb_body_def def = sb_default_body_def(), other;
    def.material = sb_material_corotated(5000, REAL(0.3), 1000);
    def.gravity = sb_v3(0, 0, -2);
    def.max_newton = 40;
    def.newton_tolerance = REAL(sizeof(sb_real) == 8 ? 1e-9 : 1e-6);
    check_refused_motion(&def, NULL, SB_OK, "");
    check_refused_motion(&def, between_reset, SB_ERROR_UNSUPPORTED, "a call after step 0");
    check_refused_motion(&def, between_rest, SB_ERROR_UNSUPPORTED, "a call after step 0");
    check_refused_motion(&def, between_speed, SB_ERROR_UNSUPPORTED, "a call after step 0");
    other = def;
    other.max_newton = 1;
    check_refused_motion(&other, NULL, SB_ERROR_UNSUPPORTED, "step 1: steps are to be of implicit Euler");
    other = def;
    other.integrator = SB_NEWMARK;
    check_refused_motion(&other, NULL, SB_ERROR_UNSUPPORTED, "implicit Euler");
    other = def;
    other.damping_stiffness = REAL(0.01);
    check_refused_motion(&other, NULL, SB_ERROR_UNSUPPORTED, "linear materials only");
    other.material = sb_material_linear(5000, REAL(0.3), 1000);
    check_refused_motion(&other, NULL, SB_OK, "");
    other = def;
    other.material = sb_material_with_prony(sb_material_neo_hookean(5000, REAL(0.3), 1000), &g, &tau, 1);
    check_refused_motion(&other, NULL, SB_ERROR_UNSUPPORTED, "Prony");
    other = def;
    other.slack = REAL(0.5);
    check_refused_motion(&other, NULL, SB_ERROR_UNSUPPORTED, "may change");
    if (sizeof(sb_real) == sizeof(double)) {
        other = def;
        other.newton_tolerance = REAL(0.05);
        check_refused_motion(&other, NULL, SB_ERROR_NOT_CONVERGED, "step 1: forces are out of balance");
    }
}

/* Each allocation fails in turn. */
static void test_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_mesh mesh = scene_box(SB_TET4, 2, 1, 1, sb_v3(1, REAL(0.5), REAL(0.5)), 0);
    sb_body_def def = sb_default_body_def();
    sb_recording *recording = NULL;
    sb_recording_slopes slopes;
    motion m;
    sb_recording_loss loss = motion_loss(&m);
    sb_result result = SB_ERROR_MEMORY;
    sb_vec3 *force;
    int failures = 0, live;
    def.mesh = &mesh;
    def.material = sb_material_neo_hookean(5000, REAL(0.3), 1000);
    def.gravity = sb_v3(0, 0, -2);
    def.max_newton = 40;
    def.newton_tolerance = REAL(1e-6);
    def.allocator = scene_allocator(&memory);
    memset(&m, 0, sizeof m);
    m.mesh = mesh;
    m.body = scene_body(&def);
    scene_fix_plane(m.body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_recording_start(m.body, 0, NULL, &recording, NULL));
    for (int i = 0; i < 3; i++)
        CHECK_OK(sb_body_step(m.body, REAL(0.01), NULL));
    sb_recording_stop(recording);
    force = (sb_vec3 *)malloc(3 * (size_t)mesh.node_count * sizeof *force);
    memset(&slopes, 0, sizeof slopes);
    slopes.force = force;
    live = memory.live;
    for (int n = 1; result != SB_OK && n < 400; n++) {
        uint64_t hash = sb_body_state_hash(m.body);
        sb_error error;
        memory.calls = 0;
        memory.fail_at = n;
        result = sb_recording_gradient(recording, m.body, &loss, NULL, 0, &slopes, &error);
        memory.fail_at = 0;
        failures += result != SB_OK;
        if (result != SB_OK)
            CHECK_RESULT(result, SB_ERROR_MEMORY);
        CHECK(memory.live == live);
        CHECK(sb_body_state_hash(m.body) == hash);
    }
    CHECK_OK(result);
    CHECK(failures > 12);
    free(force);
    sb_recording_destroy(recording);
    sb_body_destroy(m.body);
    sb_mesh_free(&mesh);
    CHECK(memory.live == 0);
}

CHECK_SUITE(motion, {"gradients", test_gradients}, {"same bits", test_same_bits}, {"threads", test_threads},
            {"parameters that are refused", test_refused_parameters},
            {"motions that are refused", test_refused_motions}, {"memory", test_memory});
