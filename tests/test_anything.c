/* Tests of what holds for every body, on cases that nobody chose (random_case.h): forces balance, energy is not made,
 * threads and saved states do not change a bit, turning or moving the world or measuring it in other units does not
 * change the answer, nothing becomes NaN, and what cannot be computed is an error that leaves the body as it was.
 * CHECK_SLOW=1: many more cases. ANYTHING=n runs case n alone. */
#include "random_case.h"
#include "softbody.h"

enum { STEPS = 6 };

static int case_count(int usual) { return getenv("CHECK_SLOW") ? 40 * usual : check_quick() ? usual / 2 : usual; }

/* Calls `what` on so many cases from `first` on; says which failed. */
static void each_case(int first, int usual, int violence, void (*what)(const random_case *c))
{
    const char *one = getenv("ANYTHING");
    int count = one ? 1 : case_count(usual);
    for (int i = 0; i < count; i++) {
        random_case c;
        int failures = check.failures;
        if (random_case_make(&c, (unsigned long long)(one ? atoi(one) : first + i), violence))
            what(&c);
        if (check.failures != failures)
            printf("%s, %d nodes\n", c.name, c.mesh.node_count);
        random_case_free(&c);
    }
}

static sb_jobs no_jobs(void)
{
    sb_jobs jobs;
    memset(&jobs, 0, sizeof jobs);
    return jobs;
}

static double tight(void) { return scene_tolerance(1e-11, 1e2); }

static unsigned long long bits(const sb_body *body)
{
    size_t bytes = (size_t)sb_body_node_count(body) * sizeof(sb_vec3);
    return scene_hash(sb_body_positions(body), bytes) ^ 3 * scene_hash(sb_body_velocities(body), bytes) ^
           5 * scene_hash(sb_body_reactions(body), bytes);
}

static sb_vec3 net_force(const sb_body *body)
{
    int n = sb_body_node_count(body);
    return sb_v3_add(scene_sum(sb_body_external_forces(body), n), scene_sum(sb_body_reactions(body), n));
}

static double force_size(const sb_body *body)
{
    double sum = 0;
    for (int i = 0; i < sb_body_node_count(body); i++)
        sum += (double)sb_v3_norm(sb_body_external_forces(body)[i]);
    return sum;
}

/* ---- forces balance ---- */

static void check_static_balance(const random_case *c)
{
    sb_body *body = random_case_body(c, no_jobs(), tight());
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    options.tolerance = REAL(scene_tolerance(1e-9, 1e3));
    if (!body)
        return;
    if (CHECK_OK(sb_body_solve_static(body, &options, &info)))
        CHECK_NEAR(sb_v3_norm(net_force(body)), 0, scene_tolerance(1e-8, 3e4) * force_size(body));
    else
        printf("%s\n", info.error.message);
    sb_body_destroy(body);
}

/* Loads and reactions are the rate of momentum of an implicit Euler step. */
static void check_momentum(const random_case *given)
{
    random_case c = *given;
    sb_body *body;
    c.integrator = SB_EULER;
    body = random_case_body(&c, no_jobs(), tight());
    for (int s = 0; body && s < STEPS; s++) {
        sb_vec3 before = sb_body_momentum(body), rate;
        if (!CHECK_OK(sb_body_step(body, c.dt, NULL)))
            break;
        rate = sb_v3_scale(1 / c.dt, sb_v3_sub(sb_body_momentum(body), before));
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(rate, net_force(body))), 0, scene_tolerance(1e-7, 1e5) * force_size(body));
    }
    sb_body_destroy(body);
}

static void test_balance(void)
{
    each_case(0, 20, 0, check_static_balance);
    each_case(1000, 10, 0, check_momentum);
}

/* ---- energy ---- */

/* What gravity has done since the rest shape, as a dead load. */
static double work_of_loads(const sb_body *body)
{
    double work = 0;
    for (int i = 0; i < sb_body_node_count(body); i++)
        work += (double)sb_v3_dot(sb_body_external_forces(body)[i], sb_body_displacements(body)[i]);
    return work;
}

/* Implicit Euler, iterated, under gravity from rest: what is in the body is at most what gravity did. */
static void check_energy(const random_case *given)
{
    random_case c = *given;
    sb_body *body;
    double most = 0;
    c.integrator = SB_EULER;
    body = random_case_body(&c, no_jobs(), tight());
    for (int s = 0; body && s < 2 * STEPS; s++) {
        sb_energy energy;
        double work;
        if (!CHECK_OK(sb_body_step(body, c.dt, NULL)) || !CHECK_OK(sb_body_energy(body, &energy)))
            break;
        work = work_of_loads(body);
        most = fmax(most, fabs(work));
        CHECK((double)energy.elastic >= -1e-6 * most);
        if (!CHECK((double)energy.elastic + (double)energy.kinetic <= work + scene_tolerance(1e-6, 1e4) * most))
            printf("step %d: elastic %g, kinetic %g, work %g\n", s, (double)energy.elastic, (double)energy.kinetic,
                   work);
    }
    sb_body_destroy(body);
}

static void test_energy(void) { each_case(2000, 16, 0, check_energy); }

/* ---- the same bits ---- */

static unsigned long long play(const random_case *c, sb_jobs jobs, sb_result *last)
{
    sb_body *body = random_case_body(c, jobs, 1e-3);
    unsigned long long hash = 0;
    for (int s = 0; body && s < STEPS; s++) {
        *last = sb_body_step(body, c->dt, NULL);
        hash = hash * 31 + bits(body);
    }
    sb_body_destroy(body);
    return hash;
}

static void check_threads(const random_case *c)
{
    int three = 3;
    sb_result alone = SB_OK, shared = SB_OK;
    CHECK(play(c, no_jobs(), &alone) == play(c, scene_jobs(&three), &shared));
    CHECK_INT(alone, shared);
}

static void check_saved(const random_case *c)
{
    sb_body *body = random_case_body(c, no_jobs(), 1e-3), *other = random_case_body(c, no_jobs(), 1e-3);
    size_t size = body ? sb_body_state_size(body) : 0;
    void *image = malloc(size + 1);
    sb_result results[STEPS];
    for (int s = 0; body && s < STEPS / 2; s++)
        sb_body_step(body, c->dt, NULL);
    if (body && other && image && CHECK_OK(sb_body_state_save(body, image, size)) &&
        CHECK_OK(sb_body_state_load(other, image, size, NULL))) {
        for (int s = 0; s < STEPS; s++)
            results[s] = sb_body_step(body, c->dt, NULL);
        for (int s = 0; s < STEPS; s++)
            CHECK_RESULT(sb_body_step(other, c->dt, NULL), results[s]);
        CHECK(bits(body) == bits(other));
        CHECK(sb_body_state_hash(body) == sb_body_state_hash(other));
    }
    free(image);
    sb_body_destroy(body);
    sb_body_destroy(other);
}

static void test_bits(void)
{
    each_case(3000, 10, 0, check_threads);
    each_case(4000, 10, 1, check_threads);
    each_case(5000, 10, 0, check_saved);
    each_case(6000, 10, 1, check_saved);
}

/* ---- the same answer ---- */

/* Displacements of a case after its steps; to be freed. NULL (with a failed check) when a step fails. */
static sb_vec3 *answer(const random_case *c)
{
    sb_body *body = random_case_body(c, no_jobs(), tight());
    size_t bytes = (size_t)c->mesh.node_count * sizeof(sb_vec3);
    sb_vec3 *u = (sb_vec3 *)malloc(bytes);
    int ok = body && u;
    for (int s = 0; ok && s < STEPS; s++)
        ok = CHECK_OK(sb_body_step(body, c->dt, NULL));
    if (ok) {
        memcpy(u, sb_body_displacements(body), bytes);
    } else {
        free(u);
        u = NULL;
    }
    sb_body_destroy(body);
    return u;
}

/* Two answers, the second to be scaled and turned back. */
static void compare(const random_case *c, sb_vec3 *first, sb_vec3 *second, double scale, sb_quat turn)
{
    double largest = 0;
    if (first && second) {
        for (int i = 0; i < c->mesh.node_count; i++) {
            second[i] = sb_v3_scale(REAL(1 / scale), sb_quat_rotate(sb_quat_conjugate(turn), second[i]));
            largest = fmax(largest, (double)sb_v3_norm(first[i]));
        }
        CHECK(largest > 0);
        CHECK_NEAR(scene_distance(first, second, c->mesh.node_count) / largest, 0, scene_tolerance(1e-6, 1e5));
    }
    free(first);
    free(second);
}

/* A case whose mesh may be changed. */
static random_case copy_of(const random_case *c)
{
    random_case copy = *c;
    memset(&copy.mesh, 0, sizeof copy.mesh);
    CHECK_OK(sb_mesh_copy(&c->mesh, NULL, &copy.mesh, NULL));
    return copy;
}

static void check_turned(const random_case *c)
{
    random_case other = copy_of(c);
    unsigned long long seed = c->seed + 77;
    sb_quat turn = random_turn(&seed);
    sb_vec3 size = sb_v3_sub(c->mesh.nodes[0], c->mesh.nodes[c->mesh.node_count - 1]);
    sb_vec3 shift = sb_v3_scale(sb_v3_norm(size), random_direction(&seed));
    for (int i = 0; i < c->mesh.node_count; i++)
        other.mesh.nodes[i] = sb_v3_add(shift, sb_quat_rotate(turn, c->mesh.nodes[i]));
    other.gravity = sb_quat_rotate(turn, c->gravity);
    compare(c, answer(c), answer(&other), 1, turn);
    sb_mesh_free(&other.mesh);
}

/* mm, g and ms instead of m, kg and s. */
static void check_units(const random_case *c)
{
    random_case other = copy_of(c);
    for (int i = 0; i < c->mesh.node_count; i++)
        other.mesh.nodes[i] = sb_v3_scale(1000, c->mesh.nodes[i]);
    other.gravity = sb_v3_scale(REAL(1e-3), c->gravity);
    other.dt *= 1000;
    other.damping *= 1000;
    other.material.lambda *= REAL(1e-6);
    other.material.mu *= REAL(1e-6);
    other.material.density *= REAL(1e-6);
    compare(c, answer(c), answer(&other), 1000, sb_quat_identity());
    sb_mesh_free(&other.mesh);
}

static void test_frames(void) { each_case(7000, 16, 0, check_turned); }
static void test_units(void) { each_case(8000, 16, 0, check_units); }

/* ---- violence ---- */

static void check_violence(const random_case *c)
{
    sb_body *body = random_case_body(c, no_jobs(), 1e-3);
    for (int s = 0; body && s < 2 * STEPS; s++) {
        uint64_t before = sb_body_state_hash(body);
        sb_step_info info;
        sb_result result = sb_body_step(body, c->dt, &info);
        CHECK(scene_all_finite(sb_body_positions(body), c->mesh.node_count));
        CHECK(scene_all_finite(sb_body_velocities(body), c->mesh.node_count));
        CHECK(scene_all_finite(sb_body_reactions(body), c->mesh.node_count));
        if (result == SB_OK)
            continue;
        CHECK_INT(info.error.result, result);
        CHECK(info.error.message[0] != 0);
        CHECK(sb_body_state_hash(body) == before);
        sb_body_reset(body);
    }
    sb_body_destroy(body);
}

static void test_violence(void) { each_case(9000, 40, 1, check_violence); }

CHECK_SUITE(anything, {"forces balance", test_balance}, {"energy is not made", test_energy}, {"same bits", test_bits},
            {"turned and moved", test_frames}, {"mm, g and ms", test_units}, {"violence", test_violence});
