/* Tests of unassembled: steps of clouds that make no matrix take the motion of those that do. */
#include "particle_scene.h"

#include "softbody.h"

/* What steps of one scene differ in. */
typedef struct cloud_steps {
    sb_precond_kind kind;
    sb_integrator integrator;
    sb_particle_method method;
    int points, loads; /* per cell; 1: springs, a potential and rows that stabilise */
    double dt, tolerance;
    sb_jobs jobs;
} cloud_steps;

static double now;
static double tick(void) { return now += 1; } /* tells which phases a step had */

/* Loads of rows, with lines that one of them leaves out. */
static void load_cloud(const sb_particles *p, sb_body *body)
{
    const sb_vec3 point = sb_v3(REAL(0.1), REAL(0.2), REAL(1.1));
    const sb_real stiffness = 300;
    int node = p->mesh.node_count / 2;
    CHECK_OK(sb_body_add_springs(body, &node, 1, &stiffness, 1, &point, NULL, NULL));
    if (p->def.method != SB_PARTICLES_SPH)
        CHECK_OK(sb_particles_stabilise(p, body, REAL(0.02), NULL, NULL));
}

/* Steps of a shaken block that hangs at one side while another is pulled; `each` hears of every step's end. */
static void play_cloud(const cloud_steps *how, int steps, void (*each)(void *user, sb_body *body, const sb_step_info *),
                       void *user)
{
    unsigned long long seed = 21;
    particle_cloud cloud = random_cloud(&seed, 7, 6, 5, 1, 0.2);
    sb_particles_def settings = sb_default_particles_def();
    sb_particles p;
    sb_body_def def;
    sb_body *body;
    int tool = 0;
    cloud_use(&cloud, &settings);
    settings.method = how->method;
    settings.points_per_cell = how->points;
    p = make_particles(&settings);
    def = cloud_body_def(&p, sb_material_corotated(3000, REAL(0.35), 900));
    def.gravity = sb_v3(REAL(0.5), REAL(-0.3), REAL(-9.81));
    def.integrator = how->integrator;
    def.damping_stiffness = REAL(0.004);
    def.damping_mass = REAL(0.1);
    def.preconditioner = how->kind;
    def.max_newton = 1;
    def.tolerance = REAL(how->tolerance);
    def.jobs = how->jobs;
    def.clock = tick;
    body = scene_body(&def);
    if (!body)
        return;
    scene_fix_plane(body, &p.mesh, 0, 0, SB_XYZ);
    for (int i = 0; i < p.mesh.node_count; i++)
        if (p.mesh.nodes[i].x + p.mesh.nodes[i].z > p.mesh.nodes[tool].x + p.mesh.nodes[tool].z)
            tool = i;
    if (how->loads)
        load_cloud(&p, body);
    for (int s = 0; s < steps; s++) {
        sb_vec3 target = sb_v3(0, 0, REAL(0.003) * REAL(s));
        sb_step_info info;
        CHECK_OK(sb_body_prescribe(body, &tool, 1, SB_Y | SB_Z, &target, 1));
        CHECK_OK(sb_body_step(body, REAL(how->dt), &info));
        each(user, body, &info);
    }
    sb_body_destroy(body);
    sb_particles_free(&p);
    cloud_free(&cloud);
}

/* ---- the same motion ---- */

enum { MOST_PARTICLES = 400, STEPS = 12 };

typedef struct cloud_film {
    int steps, tangents; /* tangents: steps that made one */
    double iterations;
    sb_vec3 u[STEPS][MOST_PARTICLES], reaction[STEPS][MOST_PARTICLES];
} cloud_film;

static void film_step(void *user, sb_body *body, const sb_step_info *info)
{
    cloud_film *film = (cloud_film *)user;
    size_t bytes = (size_t)sb_body_node_count(body) * sizeof(sb_vec3);
    memcpy(film->u[film->steps], sb_body_displacements(body), bytes);
    memcpy(film->reaction[film->steps], sb_body_reactions(body), bytes);
    film->steps++;
    film->tangents += info->seconds_tangent > 0;
    film->iterations += info->pcg_iterations;
    CHECK(info->residual <= 1);
}

/* Largest distance of two fields over the largest of the second. */
static double apart(const sb_vec3 *a, const sb_vec3 *b, int count)
{
    double size = 0, most = 0;
    for (int i = 0; i < count; i++) {
        size = fmax(size, (double)sb_v3_norm(b[i]));
        most = fmax(most, (double)sb_v3_norm(sb_v3_sub(a[i], b[i])));
    }
    return size > 0 ? most / size : most;
}

static void test_same(void)
{
    static const sb_integrator integrators[3] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA};
    static cloud_film whole, without;
    for (int trial = 0; trial < 12; trial++) {
        cloud_steps how;
        double least = SB_REAL_IS_FLOAT ? 2e-3 : 1e-7;
        memset(&how, 0, sizeof how);
        memset(&whole, 0, sizeof whole);
        memset(&without, 0, sizeof without);
        how.integrator = integrators[trial % 3];
        how.method = (sb_particle_method)(1 + trial % 4 % 3);
        how.points = trial % 2 ? 8 : 1;
        how.loads = trial / 6;
        how.dt = trial % 5 == 4 ? 0.002 : 0.01;
        how.tolerance = SB_REAL_IS_FLOAT ? 1e-5 : 1e-11;
        how.kind = SB_PRECOND_IC0;
        play_cloud(&how, STEPS, film_step, &whole);
        how.kind = trial % 4 == 3 ? SB_PRECOND_NONE : SB_PRECOND_AUTO;
        play_cloud(&how, STEPS, film_step, &without);
        CHECK_INT(whole.tangents, STEPS);
        CHECK(without.tangents <= (how.integrator != SB_EULER)); /* the first step looks for accelerations */
        for (int s = 0; s < STEPS; s++) {
            CHECK_NEAR(apart(without.u[s], whole.u[s], MOST_PARTICLES), 0, least);
            CHECK_NEAR(apart(without.reaction[s], whole.reaction[s], MOST_PARTICLES), 0, 100 * least);
        }
    }
}

/* Where stiffness outweighs mass, and for preconditioners that are asked for by name, there is a matrix. */
static void test_choice(void)
{
    static cloud_film film;
    const double steps[4] = {0.01, 0.5, 0.01, 0.5};
    const sb_precond_kind kinds[4] = {SB_PRECOND_AUTO, SB_PRECOND_AUTO, SB_PRECOND_BLOCK_JACOBI, SB_PRECOND_NONE};
    const int tangents[4] = {0, STEPS, STEPS, 0};
    for (int trial = 0; trial < 4; trial++) {
        cloud_steps how;
        memset(&how, 0, sizeof how);
        memset(&film, 0, sizeof film);
        how.method = SB_PARTICLES_MLS;
        how.integrator = SB_EULER;
        how.points = 1;
        how.dt = steps[trial];
        how.tolerance = 1e-3;
        how.kind = kinds[trial];
        play_cloud(&how, STEPS, film_step, &film);
        CHECK_INT(film.tangents, tangents[trial]);
    }
}

/* ---- bits ---- */

static void hash_step(void *user, sb_body *body, const sb_step_info *info)
{
    unsigned long long *hash = (unsigned long long *)user;
    size_t bytes = (size_t)sb_body_node_count(body) * sizeof(sb_vec3);
    *hash = *hash * 31 + (scene_hash(sb_body_displacements(body), bytes) ^ scene_hash(sb_body_velocities(body), bytes) ^
                          scene_hash(sb_body_reactions(body), bytes));
    CHECK(info->seconds_tangent == 0);
}

static unsigned long long hash_steps(sb_particle_method method, int workers)
{
    unsigned long long hash = 1;
    cloud_steps how;
    memset(&how, 0, sizeof how);
    how.kind = SB_PRECOND_AUTO;
    how.integrator = SB_EULER;
    how.method = method;
    how.points = 8;
    how.loads = 1;
    how.dt = 0.01;
    how.tolerance = 1e-3;
    if (workers > 0)
        how.jobs = scene_jobs(&workers);
    play_cloud(&how, 8, hash_step, &hash);
    return hash;
}

static void test_threads(void)
{
    for (int method = 1; method <= 3; method++) {
        unsigned long long first = hash_steps((sb_particle_method)method, 0);
        for (int workers = 1; workers <= 16; workers *= 4)
            CHECK(hash_steps((sb_particle_method)method, workers) == first);
    }
}

/* As in test_golden.c: the same for vectors of any width, and without. */
static void test_golden_steps(void)
{
    static const unsigned long long expected[3] = {0x170d0f7a6c98fd01ULL, 0x69d23916008bf42dULL, 0x0bdde6472797a686ULL};
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("golden hashes are of double");
        return;
    }
    for (int method = 1; method <= 3; method++) {
        unsigned long long hash = hash_steps((sb_particle_method)method, 0);
        if (!CHECK(hash == expected[method - 1]) || getenv("GOLDEN"))
            printf("  particles %d 0x%016llxULL\n", method, hash);
    }
}

/* ---- failure and states ---- */

/* A step that fails leaves no trace, and a state that was loaded goes on with the same bits. */
static void test_undone(void)
{
    unsigned long long seed = 3, expected = 0, found = 0;
    particle_cloud cloud = random_cloud(&seed, 4, 4, 4, 1, 0.1);
    sb_particles_def settings = sb_default_particles_def();
    const sb_vec3 far = sb_v3(0, 0, SB_REAL_MAX / 4);
    int node;
    sb_particles p;
    sb_body_def def;
    sb_body *body;
    size_t size, bytes;
    void *state;
    cloud_use(&cloud, &settings);
    p = make_particles(&settings);
    def = cloud_body_def(&p, sb_material_corotated(3000, REAL(0.3), 900));
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    body = scene_body(&def);
    scene_fix_plane(body, &p.mesh, 0, 0, SB_XYZ);
    bytes = (size_t)p.mesh.node_count * sizeof(sb_vec3);
    node = p.mesh.node_count - 1;
    for (int s = 0; s < 4; s++)
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    size = sb_body_state_size(body);
    state = malloc(size);
    CHECK_OK(sb_body_state_save(body, state, size));
    for (int pass = 0; pass < 3; pass++) {
        if (pass > 0)
            CHECK_OK(sb_body_state_load(body, state, size, NULL));
        if (pass == 2) {
            sb_vec3 before = sb_body_displacements(body)[node];
            check_bad_numbers();
            CHECK_OK(sb_body_add_forces(body, &node, 1, &far, 1));
            CHECK(sb_body_step(body, REAL(0.01), NULL) != SB_OK);
            CHECK(memcmp(&before, sb_body_displacements(body) + node, sizeof before) == 0);
            sb_body_clear_loads(body);
        }
        for (int s = 0; s < 3; s++)
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        found = scene_hash(sb_body_displacements(body), bytes) ^ scene_hash(sb_body_velocities(body), bytes);
        if (pass == 0)
            expected = found;
        CHECK(found == expected);
    }
    free(state);
    sb_body_destroy(body);
    sb_particles_free(&p);
    cloud_free(&cloud);
}

CHECK_SUITE(unassembled, {"the same motion", test_same}, {"choice", test_choice}, {"threads", test_threads},
            {"golden steps of particles", test_golden_steps}, {"undone and loaded", test_undone});
