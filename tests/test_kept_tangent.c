/* Tests of steps that keep their tangent (sb_body_keep_tangent): against steps that make it anew, in random bodies of
 * all sizes and with a needle; nothing that looks at a body, fails, is saved, replayed or shared out among threads
 * changes a bit; nothing is allocated. */
#include "image.h"
#include "needle_scene.h"
#include "particle_scene.h"
#include "random_case.h"

/* ---- a body that swings -------------------------------------------------------------------------------- */

/* Each look at it is a second: phases that were left out take none. */
static double ticks;
static double tick(void) { return ticks++; }

typedef struct swing {
    sb_mesh mesh;
    sb_body_def def;
    sb_body *body;
    double size;
    sb_real dt, push; /* s; N on the node that is pushed */
    int node, steps, made;
    unsigned long long seed;
} swing;

/* A block of random cells, size and integrator, held at one side, that gravity bends. */
static swing swing_begin(unsigned long long number, double scale)
{
    swing s;
    sb_vec3 size;
    double young = 1e4, density = 1000;
    memset(&s, 0, sizeof s);
    s.seed = 0x9E3779B97F4A7C15ULL * (number + 1);
    for (int i = 0; i < 8; i++)
        check_random(&s.seed);
    s.size = 0.1 * scale;
    size = sb_v3(REAL(0.1), REAL(check_random_in(&s.seed, 0.02, 0.06)), REAL(0.04));
    s.mesh = scene_box(SB_TET4, 4 + random_below(&s.seed, 4), 2 + random_below(&s.seed, 2), 3, size,
                       check_random_in(&s.seed, 0, 0.2));
    if (number % 2)
        random_grade(&s.seed, &s.mesh);
    for (int i = 0; i < s.mesh.node_count; i++)
        s.mesh.nodes[i] = sb_v3_scale(REAL(scale), s.mesh.nodes[i]);
    s.def = sb_default_body_def();
    s.def.integrator = number % 3 == 0 ? SB_EULER : SB_GENERALISED_ALPHA;
    s.def.spectral_radius = number % 3 == 1 ? 0 : REAL(0.3);
    s.def.mass = number % 4 < 2 ? SB_MASS_LUMPED : SB_MASS_CONSISTENT;
    s.def.max_newton = 1;
    s.def.preconditioner = number % 5 == 4 ? SB_PRECOND_SSOR : SB_PRECOND_IC0;
    s.def.tolerance = REAL(scene_tolerance(1e-9, 2e3));
    s.def.max_iterations = 2000;
    s.def.clock = tick;
    s.dt = REAL(0.03 * s.size * sqrt(density / young));
    s.def.damping_stiffness = REAL(check_random_in(&s.seed, 0.1, 3)) * s.dt;
    s.def.material = sb_material_corotated(REAL(young), REAL(check_random_in(&s.seed, 0.1, 0.47)), REAL(density));
    s.def.gravity = sb_v3(0, 0, REAL(-0.06 * young / (density * s.size)));
    s.push = REAL(0.002 * young * s.size * s.size);
    return s;
}

static int swing_make(swing *s)
{
    s->def.mesh = &s->mesh;
    s->body = scene_body(&s->def);
    s->steps = s->made = 0;
    for (int i = 0; i < s->mesh.node_count; i++)
        if (s->mesh.nodes[i].x > s->mesh.nodes[s->node].x)
            s->node = i;
    return s->body && scene_fix_plane(s->body, &s->mesh, 0, 0, SB_XYZ) > 0;
}

static void swing_free(swing *s)
{
    sb_body_destroy(s->body);
    s->body = NULL;
}

/* One step of a push that comes and goes. */
static sb_result swing_step(swing *s)
{
    sb_step_info info;
    sb_vec3 force = sb_v3(0, s->steps % 80 < 40 ? s->push : -s->push, 0);
    sb_result result;
    sb_body_clear_loads(s->body);
    CHECK_OK(sb_body_apply_forces(s->body, &s->node, 1, &force, 1, NULL));
    result = sb_body_step(s->body, s->dt, &info);
    s->made += info.seconds_precond > 0;
    s->steps++;
    return result;
}

static void swing_run(swing *s, int steps)
{
    for (int i = 0; i < steps; i++)
        CHECK_OK(swing_step(s));
}

static double largest(const sb_vec3 *u, int count)
{
    double most = 0;
    for (int i = 0; i < count; i++)
        most = fmax(most, (double)sb_v3_norm(u[i]));
    return most;
}

/* ---- accuracy ------------------------------------------------------------------------------------------ */

/* What steps that keep up to `angle` are off by after a swing, of the largest displacement; *made: share of steps that
 * made a tangent. */
static double swing_error(unsigned long long number, double scale, double angle, double *made)
{
    swing kept = swing_begin(number, scale), fresh = kept;
    double worst = 0, most = 0;
    enum { STEPS = 200 };
    *made = 1;
    if (!CHECK(swing_make(&kept)) || !CHECK(swing_make(&fresh)))
        return 1;
    CHECK_OK(sb_body_keep_tangent(kept.body, REAL(angle), NULL));
    for (int i = 0; i < STEPS; i++) {
        swing_run(&kept, 1);
        swing_run(&fresh, 1);
        worst = fmax(worst, scene_distance(sb_body_displacements(kept.body), sb_body_displacements(fresh.body),
                                           kept.mesh.node_count));
        most = fmax(most, largest(sb_body_displacements(fresh.body), kept.mesh.node_count));
    }
    CHECK_INT(fresh.made, STEPS);
    *made = kept.made / (double)STEPS;
    swing_free(&kept);
    swing_free(&fresh);
    sb_mesh_free(&kept.mesh);
    return worst / most;
}

/* Of the largest displacement no more than a fifth of the angle, and less where that is smaller; many steps make none.
 */
static void test_accuracy(void)
{
    static const double scales[] = {1e-3, 1, 1e3};
    int count = check_rounds(9);
    for (int k = 0; k < count; k++) {
        double seldom, often, rough, fine, rounding = scene_tolerance(1e-7, 3e4);
        rough = swing_error((unsigned long long)k, scales[k % 3], 0.05, &seldom);
        fine = swing_error((unsigned long long)k, scales[k % 3], 0.01, &often);
        if (!CHECK(rough < 0.2 * 0.05 + rounding) || !CHECK(fine < 0.2 * 0.01 + rounding) || !CHECK(seldom < often) ||
            !CHECK(seldom < 0.8))
            printf("swing %d: off by %g with %g tangents a step at 0.05, %g with %g at 0.01\n", k, rough, seldom, fine,
                   often);
    }
}

/* Forces are those of the present shape: a body comes to rest where it would otherwise. */
static void test_rest(void)
{
    swing kept = swing_begin(2, 1), fresh;
    double most;
    kept.push = 0;
    kept.dt *= 10;
    kept.def.damping_mass = REAL(0.1) / kept.dt;
    kept.def.damping_stiffness = kept.dt;
    fresh = kept;
    if (!CHECK(swing_make(&kept)) || !CHECK(swing_make(&fresh)))
        return;
    CHECK_OK(sb_body_keep_tangent(kept.body, REAL(0.3), NULL));
    swing_run(&kept, 300);
    swing_run(&fresh, 300);
    most = largest(sb_body_displacements(fresh.body), fresh.mesh.node_count);
    CHECK(most > 0.1 * fresh.size);
    CHECK(kept.made < 20);
    CHECK_NEAR(
        scene_distance(sb_body_displacements(kept.body), sb_body_displacements(fresh.body), fresh.mesh.node_count), 0,
        scene_tolerance(1e-6, 1e5) * most);
    CHECK_NEAR(scene_distance(sb_body_reactions(kept.body), sb_body_reactions(fresh.body), fresh.mesh.node_count), 0,
               scene_tolerance(1e-5, 1e5) * largest(sb_body_reactions(fresh.body), fresh.mesh.node_count));
    swing_free(&kept);
    swing_free(&fresh);
    sb_mesh_free(&kept.mesh);
}

/* A block of nearly incompressible tissue falls against its support in long steps. Returns the largest displacement on
 * the way; *rest: the displacements at last, to be freed. */
static double fall(sb_mesh *mesh, double poisson, double dt, double angle, sb_vec3 **rest)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    size_t size = (size_t)mesh->node_count * sizeof(sb_vec3);
    double most = 0;
    def.mesh = mesh;
    def.material = sb_material_corotated(10000, REAL(poisson), 1000);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.max_newton = 1;
    def.tolerance = REAL(scene_tolerance(1e-9, 1e3));
    def.max_iterations = 2000;
    body = scene_body(&def);
    *rest = (sb_vec3 *)calloc(1, size);
    if (!CHECK(body && *rest) || !CHECK(scene_fix_plane(body, mesh, 0, 0, SB_XYZ) > 0))
        return 0;
    CHECK_OK(sb_body_keep_tangent(body, REAL(angle), NULL));
    for (int i = 0; i < 250; i++) {
        CHECK_OK(sb_body_step(body, REAL(dt), NULL));
        most = fmax(most, largest(sb_body_displacements(body), mesh->node_count));
    }
    memcpy(*rest, sb_body_displacements(body), size);
    sb_body_destroy(body);
    return most;
}

/* Whatever the angle, long steps gain nothing by what they keep, and come to rest. */
static void test_long_steps(void)
{
    static const double cases[][3] = {{0.45, 0.1, 0.3}, {0.49, 0.02, 0.1}, {0.499, 0.02, 0.05}, {0.499, 0.1, 1}};
    sb_mesh mesh = scene_box(SB_TET4, 5, 2, 2, sb_v3(REAL(0.1), REAL(0.03), REAL(0.03)), 0);
    for (int k = 0; k < check_rounds(4); k++) {
        sb_vec3 *kept, *fresh;
        double at_most = fall(&mesh, cases[k][0], cases[k][1], 0, &fresh);
        double most = fall(&mesh, cases[k][0], cases[k][1], cases[k][2], &kept);
        if (!CHECK(most < 1.1 * at_most) ||
            !CHECK(scene_distance(kept, fresh, mesh.node_count) < scene_tolerance(1e-5, 1e3) * at_most))
            printf("Poisson's ratio %g, steps of %g s, kept up to %g: moved by %g, not %g\n", cases[k][0], cases[k][1],
                   cases[k][2], most, at_most);
        free(kept);
        free(fresh);
    }
    sb_mesh_free(&mesh);
}

/* About the origin, of unit masses. */
static sb_vec3 sum_of_spins(const sb_body *body)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int i = 0; i < sb_body_node_count(body); i++)
        sum = sb_v3_add(sum, sb_v3_cross(sb_body_positions(body)[i], sb_body_velocities(body)[i]));
    return sum;
}

/* What nothing holds keeps its momentum, and spins on. */
static void test_free(void)
{
    swing s = swing_begin(5, 1);
    sb_vec3 spin = sb_v3(2, 3, 5), last[2];
    s.def.mesh = &s.mesh;
    s.def.gravity = sb_v3(0, 0, 0);
    s.def.integrator = SB_GENERALISED_ALPHA;
    s.def.spectral_radius = 0;
    for (int keeps = 0; keeps < 2; keeps++) {
        sb_vec3 *v = (sb_vec3 *)malloc((size_t)s.mesh.node_count * sizeof *v), before;
        s.body = scene_body(&s.def);
        if (!CHECK(v && s.body))
            return;
        for (int i = 0; i < s.mesh.node_count; i++)
            v[i] = sb_v3_add(sb_v3(1, 0, 0), sb_v3_cross(spin, s.mesh.nodes[i]));
        CHECK_OK(sb_body_set_velocities(s.body, v));
        free(v);
        CHECK_OK(sb_body_keep_tangent(s.body, REAL(keeps ? 0.05 : 0), NULL));
        before = sb_body_momentum(s.body);
        for (int i = 0; i < 100; i++)
            CHECK_OK(sb_body_step(s.body, s.dt, NULL));
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(sb_body_momentum(s.body), before)), 0,
                   scene_tolerance(1e-6, 1e4) * (double)sb_v3_norm(before));
        last[keeps] = sum_of_spins(s.body);
        swing_free(&s);
    }
    CHECK(sb_v3_norm(sb_v3_sub(last[1], last[0])) < REAL(0.005) * sb_v3_norm(last[0]));
    sb_mesh_free(&s.mesh);
}

/* ---- bits ---------------------------------------------------------------------------------------------- */

static void same_bits(const sb_body *a, const sb_body *b, const char *what)
{
    if (!CHECK(sb_body_state_hash(a) == sb_body_state_hash(b)))
        printf("after %s\n", what);
}

/* What reads a body and uses its matrix for that: the one or the other. */
static void look_at(sb_body *body, int which)
{
    int n = sb_body_node_count(body);
    sb_vec3 *y = (sb_vec3 *)calloc((size_t)n, sizeof *y);
    sb_real dt;
    if (!CHECK(y != NULL))
        return;
    if (which % 2)
        CHECK_OK(sb_body_multiply_tangent(body, SB_TANGENT_SPD, sb_body_positions(body), y, NULL));
    else
        CHECK_OK(sb_body_stable_step(body, &dt, NULL));
    free(y);
}

/* A step so long that it makes another tangent, and then finds that nodes coast beyond all range. */
static void fail_step(const swing *s)
{
    const double dt = SB_REAL_IS_FLOAT ? 1e38 : 1e200;
    CHECK_RESULT(sb_body_step(s->body, REAL(dt), NULL), SB_ERROR_DIVERGED);
}

static void test_bits(void)
{
    swing plain = swing_begin(6, 1), seen, loaded;
    void *state;
    size_t size;
    seen = loaded = plain;
    if (!CHECK(swing_make(&plain)) || !CHECK(swing_make(&seen)) || !CHECK(swing_make(&loaded)))
        return;
    CHECK_OK(sb_body_keep_tangent(plain.body, REAL(0.05), NULL));
    CHECK_OK(sb_body_keep_tangent(seen.body, REAL(0.05), NULL));
    for (int k = 0; k < 4; k++) {
        swing_run(&plain, 11);
        swing_run(&seen, 11);
        look_at(seen.body, k);
        swing_run(&plain, 2);
        swing_run(&seen, 2);
        same_bits(plain.body, seen.body, "looks");
        swing_run(&plain, 1);
        check_bad_numbers();
        fail_step(&seen);
        swing_run(&seen, 1);
        same_bits(plain.body, seen.body, "a step that failed");
        size = sb_body_state_size(plain.body);
        state = malloc(size);
        CHECK_OK(sb_body_state_save(plain.body, state, size));
        CHECK_OK(sb_body_state_load(loaded.body, state, size, NULL)); /* which has kept nothing at first */
        loaded.steps = plain.steps;
        free(state);
        same_bits(plain.body, loaded.body, "a load");
        swing_run(&plain, 9);
        swing_run(&seen, 9);
        swing_run(&loaded, 9);
        same_bits(plain.body, seen.body, "more steps");
        same_bits(plain.body, loaded.body, "steps from a state");
    }
    CHECK(plain.made < plain.steps / 2);
    swing_free(&plain);
    swing_free(&seen);
    swing_free(&loaded);
    sb_mesh_free(&plain.mesh);
}

/* A state is taken while a node that was held is free, and then it is held again. */
static void test_supports(void)
{
    swing s[2];
    void *state;
    size_t size;
    int held = -1;
    for (int k = 0; k < 2; k++) {
        s[k] = swing_begin(6, 1);
        if (!CHECK(swing_make(&s[k])))
            return;
    }
    swing_run(&s[0], 3); /* what is kept then is not what comes from rest */
    CHECK_OK(sb_body_keep_tangent(s[0].body, REAL(0.5), NULL));
    swing_run(&s[0], 3);
    CHECK_INT(s[0].made, 4);
    for (int i = 0; i < s[0].mesh.node_count; i++)
        if (sb_body_supports(s[0].body)[i] == SB_XYZ)
            held = i;
    CHECK_OK(sb_body_release(s[0].body, &held, 1, SB_Y, NULL));
    size = sb_body_state_size(s[0].body);
    state = malloc(size);
    CHECK_OK(sb_body_state_save(s[0].body, state, size));
    CHECK_OK(sb_body_state_load(s[1].body, state, size, NULL));
    free(state);
    s[1].steps = s[0].steps;
    for (int k = 0; k < 2; k++) {
        CHECK_OK(sb_body_hold(s[k].body, &held, 1, SB_Y, NULL));
        swing_run(&s[k], 5);
    }
    same_bits(s[0].body, s[1].body, "a support that came back");
    s[0].made = 0;
    CHECK_OK(sb_body_hold(s[0].body, &held, 1, SB_XYZ, NULL)); /* as it is */
    CHECK_OK(sb_body_release(s[0].body, &s[0].node, 1, SB_XYZ, NULL));
    swing_run(&s[0], 1);
    CHECK_INT(s[0].made, 0);
    for (int k = 0; k < 2; k++) {
        swing_free(&s[k]);
        sb_mesh_free(&s[k].mesh);
    }
}

/* Nothing is remembered. */
static void test_reset(void)
{
    swing s[2];
    for (int k = 0; k < 2; k++) {
        s[k] = swing_begin(6, 1);
        if (!CHECK(swing_make(&s[k])))
            return;
    }
    swing_run(&s[1], 3);
    for (int k = 0; k < 2; k++)
        CHECK_OK(sb_body_keep_tangent(s[k].body, REAL(0.5), NULL));
    swing_run(&s[1], 3);
    CHECK_INT(s[1].made, 4);
    sb_body_reset(s[1].body);
    s[1].steps = 0;
    for (int k = 0; k < 2; k++)
        swing_run(&s[k], 9);
    same_bits(s[0].body, s[1].body, "a reset");
    for (int k = 0; k < 2; k++) {
        swing_free(&s[k]);
        sb_mesh_free(&s[k].mesh);
    }
}

/* States without it switch it off; one with an angle that none can be is refused. */
static void test_states(void)
{
    swing s = swing_begin(6, 1);
    size_t plain_size, size, at;
    unsigned char *plain, *kept;
    uint64_t hash;
    if (!CHECK(swing_make(&s)))
        return;
    swing_run(&s, 3);
    plain_size = sb_body_state_size(s.body);
    plain = (unsigned char *)malloc(plain_size);
    CHECK_OK(sb_body_state_save(s.body, plain, plain_size));
    hash = sb_body_state_hash(s.body);
    CHECK_OK(sb_body_keep_tangent(s.body, REAL(0.0625), NULL));
    size = sb_body_state_size(s.body);
    CHECK(size > plain_size);
    swing_run(&s, 3);
    CHECK(sb_body_state_size(s.body) == size); /* whatever there is to keep */
    kept = (unsigned char *)malloc(size);
    CHECK_OK(sb_body_state_save(s.body, kept, size));
    CHECK_OK(sb_body_state_load(s.body, plain, plain_size, NULL));
    CHECK(sb_body_state_hash(s.body) == hash);
    CHECK(sb_body_state_size(s.body) == plain_size);
    s.made = 0;
    swing_run(&s, 3);
    CHECK_INT(s.made, 3);
    at = image_find_real(kept, size, plain_size - 16, REAL(0.0625));
    if (CHECK(at < size)) {
        image_put_real(kept + at, REAL(1.5));
        image_seal(kept, size);
        hash = sb_body_state_hash(s.body);
        CHECK_RESULT(sb_body_state_load(s.body, kept, size, NULL), SB_ERROR_FORMAT);
        CHECK(sb_body_state_hash(s.body) == hash);
    }
    free(plain);
    free(kept);
    swing_free(&s);
    sb_mesh_free(&s.mesh);
}

/* The same bits for any number of threads. */
static void test_threads(void)
{
    int workers[2] = {1, 3};
    swing s[2];
    for (int k = 0; k < 2; k++) {
        s[k] = swing_begin(8, 1);
        s[k].def.jobs = scene_jobs(&workers[k]);
        if (!CHECK(swing_make(&s[k])))
            return;
        CHECK_OK(sb_body_keep_tangent(s[k].body, REAL(0.05), NULL));
        swing_run(&s[k], 40);
    }
    same_bits(s[0].body, s[1].body, "40 steps");
    CHECK_INT(s[0].made, s[1].made);
    for (int k = 0; k < 2; k++) {
        swing_free(&s[k]);
        sb_mesh_free(&s[k].mesh);
    }
}

static void test_recording(void)
{
    swing s = swing_begin(2, 1), other = s;
    sb_recording *recording = NULL;
    sb_recording_report report;
    sb_real angles[] = {REAL(0.05), REAL(0.01), 0, REAL(0.02)};
    if (!CHECK(swing_make(&s)) || !CHECK(swing_make(&other)))
        return;
    CHECK_OK(sb_body_keep_tangent(s.body, REAL(0.1), NULL));
    swing_run(&s, 5);
    CHECK_OK(sb_recording_start(s.body, 0, NULL, &recording, NULL));
    for (int k = 0; k < 4; k++) {
        CHECK_OK(sb_body_keep_tangent(s.body, angles[k], NULL));
        swing_run(&s, 6);
        look_at(s.body, k); /* which it does not hear of */
        swing_run(&s, 6);
    }
    sb_recording_stop(recording);
    if (!CHECK_OK(sb_recording_replay(recording, other.body, &report)))
        printf("%s\n", report.error.message);
    same_bits(s.body, other.body, "a replay");
    sb_recording_destroy(recording);
    swing_free(&s);
    swing_free(&other);
    sb_mesh_free(&s.mesh);
}

/* ---- changes ------------------------------------------------------------------------------------------- */

/* What the tangent depends on changes, one thing after the other: each asks for another one, once. */
static void test_changes(void)
{
    swing s = swing_begin(0, 1); /* implicit Euler: others look for their acceleration first */
    sb_material softer;
    s.push = 0;
    s.def.gravity = sb_v3(0, 0, 0);
    if (!CHECK(swing_make(&s)))
        return;
    softer = sb_material_corotated(5000, REAL(0.3), 900);
    CHECK_OK(sb_body_keep_tangent(s.body, REAL(0.05), NULL));
    for (int k = 0; k < 5; k++) {
        s.made = 0;
        if (k == 1)
            CHECK_OK(sb_body_set_material(s.body, &softer, NULL));
        else if (k == 2)
            s.dt *= REAL(1.1);
        else if (k == 3)
            CHECK_OK(sb_body_fix_nodes(s.body, &s.node, 1, SB_X));
        else if (k == 4)
            CHECK_OK(sb_body_set_damping(s.body, 1, s.dt));
        swing_run(&s, 5);
        CHECK_INT(s.made, 1);
    }
    s.made = 0;
    CHECK_OK(sb_body_keep_tangent(s.body, 0, NULL));
    swing_run(&s, 5);
    CHECK_INT(s.made, 5);
    swing_free(&s);
    sb_mesh_free(&s.mesh);
}

/* Splits each of the first cells by a node in its middle. */
static void split_cells(sb_body *body, int count)
{
    sb_body_change *change;
    if (!CHECK_OK(sb_body_change_begin(body, &change, NULL)))
        return;
    for (int e = 0; e < count; e++) {
        const sb_real weights[4] = {REAL(0.25), REAL(0.25), REAL(0.25), REAL(0.25)};
        sb_vec3 middle = sb_v3(0, 0, 0);
        int corners[4], node, number;
        memcpy(corners, sb_body_cell_nodes(body, e), sizeof corners);
        for (int c = 0; c < 4; c++)
            middle = sb_v3_madd(middle, weights[c], sb_body_rest_positions(body)[corners[c]]);
        CHECK_OK(sb_body_change_add_node(change, middle, corners, weights, 4, 0, &node, NULL));
        for (int c = 0; c < 4; c++) {
            sb_change_cell cell = sb_default_change_cell();
            int own[4];
            memcpy(own, corners, sizeof own);
            own[c] = node;
            cell.nodes = own;
            cell.parent = e;
            CHECK_OK(c ? sb_body_change_add_cell(change, &cell, &number, NULL)
                       : sb_body_change_replace_cell(change, e, &cell, NULL));
        }
    }
    if (!CHECK_OK(sb_body_change_commit(change, NULL)))
        sb_body_change_cancel(change);
}

/* A body that keeps its tangent through changes of its mesh, in its slack and beyond, and one that is asked to only
 * after them. */
static void test_mesh(void)
{
    swing s[2];
    for (int k = 0; k < 2; k++) {
        s[k] = swing_begin(2, 1);
        s[k].def.slack = REAL(0.1);
        if (!CHECK(swing_make(&s[k])))
            return;
        if (k == 0)
            CHECK_OK(sb_body_keep_tangent(s[k].body, REAL(0.05), NULL));
        CHECK_OK(sb_body_step(s[k].body, s[k].dt, NULL));
        split_cells(s[k].body, 2);
        split_cells(s[k].body, 100);
        if (k == 1)
            CHECK_OK(sb_body_keep_tangent(s[k].body, REAL(0.05), NULL));
        s[k].made = 0;
        swing_run(&s[k], 20);
        CHECK(s[k].made < 10);
    }
    same_bits(s[0].body, s[1].body, "changes of the mesh");
    for (int k = 0; k < 2; k++) {
        swing_free(&s[k]);
        sb_mesh_free(&s[k].mesh);
    }
}

/* ---- memory and errors --------------------------------------------------------------------------------- */

static void test_memory(void)
{
    swing s = swing_begin(2, 1);
    scene_memory memory;
    int calls;
    memset(&memory, 0, sizeof memory);
    s.def.allocator = scene_allocator(&memory);
    if (!CHECK(swing_make(&s)))
        return;
    swing_run(&s, 2);
    memory.fail_at = memory.calls + 1;
    CHECK_RESULT(sb_body_keep_tangent(s.body, REAL(0.05), NULL), SB_ERROR_MEMORY);
    CHECK_OK(sb_body_keep_tangent(s.body, REAL(0.05), NULL));
    calls = memory.calls;
    swing_run(&s, 30);
    CHECK_INT(memory.calls, calls);
    CHECK(s.made < 25);
    swing_free(&s);
    CHECK_INT(memory.live, 0);
    sb_mesh_free(&s.mesh);
}

/* Clouds go through the same loops as tet4. */
static void test_cloud(void)
{
    unsigned long long seed = 5;
    particle_cloud cloud = random_cloud(&seed, 3, 2, 2, 0.1, 0.1);
    sb_particles_def def = sb_default_particles_def();
    sb_particles particles;
    sb_body_def body_def;
    sb_body *body;
    cloud_use(&cloud, &def);
    particles = make_particles(&def);
    body_def = cloud_body_def(&particles, sb_material_corotated(1000, REAL(0.3), 1000));
    body = scene_body(&body_def);
    if (CHECK(body != NULL))
        CHECK_RESULT(sb_body_keep_tangent(body, REAL(0.1), NULL), SB_ERROR_UNSUPPORTED);
    sb_body_destroy(body);
    sb_particles_free(&particles);
    cloud_free(&cloud);
}

static void test_errors(void)
{
    swing s = swing_begin(2, 1);
    sb_mesh tens;
    sb_error error;
    if (!CHECK(swing_make(&s)))
        return;
    CHECK_RESULT(sb_body_keep_tangent(NULL, REAL(0.1), &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_keep_tangent(s.body, REAL(-0.1), &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_keep_tangent(s.body, REAL(1.1), NULL), SB_ERROR_ARGUMENT);
    check_bad_numbers();
    CHECK_RESULT(sb_body_keep_tangent(s.body, REAL(NAN), &error), SB_ERROR_ARGUMENT);
    swing_free(&s);
    CHECK_OK(sb_mesh_to_tet10(&s.mesh, NULL, &tens, NULL));
    s.def.mesh = &tens;
    s.body = scene_body(&s.def);
    CHECK_RESULT(sb_body_keep_tangent(s.body, REAL(0.1), &error), SB_ERROR_UNSUPPORTED);
    CHECK(strstr(error.message, "tet4") != NULL);
    swing_free(&s);
    sb_mesh_free(&tens);
    sb_mesh_free(&s.mesh);
}

/* ---- a needle ------------------------------------------------------------------------------------------ */

/* At 1 kHz: what the hand feels and where the tip is, against tangents made anew. */
static void test_needle(void)
{
    needle_scene s[2];
    double push[2], worst = 0, most = 0;
    int made = 0;
    for (int k = 0; k < 2; k++) {
        s[k] = needle_scene_default();
        s[k].needle_def.follow = NDL_EMBED;
        s[k].needle_def.bevel.curvature = 8;
        s[k].body_def.tolerance = REAL(scene_tolerance(1e-8, 2e3));
        s[k].body_def.clock = tick;
        if (!needle_scene_make(&s[k]))
            return;
    }
    CHECK_OK(sb_body_keep_tangent(s[1].body, REAL(0.02), NULL));
    for (int i = 0; i < 250; i++) {
        for (int k = 0; k < 2; k++) {
            if (!needle_scene_run(&s[k], 1e-3, 1, needle_command(i < 200 ? 0.05 : 0, 0)))
                return;
            push[k] = needle_push(&s[k]);
        }
        made += s[1].info.body.seconds_precond > 0;
        most = fmax(most, fabs(push[0]));
        worst = fmax(worst, fabs(push[1] - push[0]));
    }
    CHECK(most > 0.1);
    CHECK(worst < 1e-3 * most);
    CHECK(made < 100);
    CHECK(sb_v3_norm(sb_v3_sub(needle_tip(s[0].needles[0]), needle_tip(s[1].needles[0]))) < REAL(1e-6));
    if (getenv("SHOW_KEPT"))
        printf("needle: push off by %g of %g N, %d of 250 tangents, tip by %g\n", worst, most, made,
               (double)sb_v3_norm(sb_v3_sub(needle_tip(s[0].needles[0]), needle_tip(s[1].needles[0]))));
    needle_scene_free(&s[0]);
    needle_scene_free(&s[1]);
}

CHECK_SUITE(kept_tangent, {"against tangents made anew", test_accuracy}, {"at rest", test_rest},
            {"long steps", test_long_steps}, {"a free body", test_free},
            {"looks, failures and states leave the bits", test_bits}, {"a support that comes back", test_supports},
            {"reset", test_reset}, {"states without it", test_states}, {"threads", test_threads},
            {"recording", test_recording}, {"changes ask for another", test_changes},
            {"a mesh that changes", test_mesh}, {"memory", test_memory}, {"errors", test_errors},
            {"clouds", test_cloud}, {"a needle at 1 kHz", test_needle});
