/* A network's guesses on grids: what they are weighed by, what is taken, and that nothing is lost by bad ones. */
#include "check.h"
#include "network_scene.h"
#include "scene.h"

/* A beam with rounded edges, in 9 x 4 x 4 cells of 1 cm of which most are cut. */
static sb_real beam_distance(void *user, sb_vec3 x)
{
    sb_real dx = sb_abs(x.x - REAL(0.045)) - REAL(0.044), dy = x.y - REAL(0.02), dz = x.z - REAL(0.02);
    (void)user;
    return sb_max(dx, sb_sqrt(dy * dy + dz * dz) - REAL(0.0195));
}

static sb_grid beam_grid(void)
{
    sb_grid_def def = sb_default_grid_def();
    sb_grid grid;
    sb_error error;
    memset(&grid, 0, sizeof grid);
    def.outer.distance = beam_distance;
    def.outer.max_slope = 1;
    def.high = sb_v3(REAL(0.09), REAL(0.04), REAL(0.04));
    def.counts[0] = 9, def.counts[1] = def.counts[2] = 4;
    def.void_stiffness = REAL(0.01);
    if (!CHECK_OK(sb_grid_create(&def, &grid, &error)))
        printf("%s\n", error.message);
    return grid;
}

static sb_body *beam_body(const sb_grid *grid, const sb_allocator *allocator)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    def.mesh = &grid->body_mesh;
    def.domain = &grid->domain;
    def.material = sb_material_stable_neo_hookean(3000, REAL(0.45), 1000);
    if (allocator)
        def.allocator = *allocator;
    body = scene_body(&def);
    scene_fix_plane(body, &grid->body_mesh, 0, 0, SB_XYZ);
    return body;
}

/* Bends it: forces on all nodes of the free end. */
static void load_beam(sb_body *body, const sb_grid *grid, sb_vec3 force)
{
    int count = 0, *nodes = (int *)malloc((size_t)grid->mesh.node_count * sizeof(int));
    for (int i = 0; i < grid->mesh.node_count; i++)
        if (grid->mesh.nodes[i].x > REAL(0.0899))
            nodes[count++] = i;
    force = sb_v3_scale(1 / (sb_real)count, force);
    CHECK_OK(sb_body_add_forces(body, nodes, count, &force, 1));
    free(nodes);
}

/* The first three channels as they come, times a factor: the guess is the input. */
static network_file copying(double factor)
{
    unsigned long long random = 1;
    network_file file = network_begin(16, 8, 8, SB_NETWORK_CHANNELS);
    network_add(&file, SB_LAYER_CONVOLUTION, 1, 0, 3, SB_ACTIVATION_NONE, 0, &random);
    for (int k = 0; k < 3; k++)
        file.layers[0].weights[3 * k + k] = (float)factor;
    network_end(&file);
    return file;
}

static sb_network *network_of(network_file file)
{
    sb_network *network = NULL;
    CHECK_OK(sb_network_load_memory(file.bytes, file.size, NULL, &network, NULL));
    network_file_free(&file);
    return network;
}

static sb_network *random_network(unsigned long long seed, double size)
{
    static const int counts[3] = {16, 8, 8};
    return network_of(network_unet(counts, 3, SB_NETWORK_CHANNELS, 2, size, seed));
}

static sb_network_input input_of(const sb_vec3 *displacements, int count, sb_network_policy policy)
{
    sb_network_input input = sb_default_network_input();
    input.displacements = displacements;
    input.count = count;
    input.policy = policy;
    return input;
}

/* The present displacements, to be freed. */
static sb_vec3 *shape_of(const sb_body *body)
{
    size_t bytes = (size_t)sb_body_node_count(body) * sizeof(sb_vec3);
    sb_vec3 *u = (sb_vec3 *)malloc(bytes);
    memcpy(u, sb_body_displacements(body), bytes);
    return u;
}

static int solve(sb_body *body)
{
    sb_step_info info;
    if (!CHECK_OK(sb_body_solve_static(body, NULL, &info)))
        printf("%s\n", info.error.message);
    return info.newton_iterations;
}

static double distance(const sb_body *a, const sb_body *b)
{
    double most = 0, size = 0;
    for (int i = 0; i < sb_body_node_count(a); i++) {
        sb_vec3 u = sb_body_displacements(a)[i], v = sb_body_displacements(b)[i];
        most = fmax(most, (double)sb_v3_norm(sb_v3_sub(u, v)));
        size = fmax(size, (double)sb_v3_norm(u));
    }
    return most / size;
}

/* Out-of-balance force by differences of the energy, on free axes and on supported ones (N). */
static void out_of_balance(sb_body *body, const sb_vec3 *forces, double *free_axes, double *held_axes)
{
    const double h = 1e-6;
    sb_vec3 *u = shape_of(body);
    double sums[2] = {0, 0};
    for (int i = 0; i < sb_body_node_count(body); i++)
        for (int axis = 0; axis < 3; axis++) {
            sb_real *at = &u[i].x + axis, before = *at;
            sb_energy more, less;
            int held = sb_body_supports(body)[i] >> axis & 1;
            double force;
            *at = before + REAL(h);
            CHECK_OK(sb_body_set_displacements(body, u));
            CHECK_OK(sb_body_energy(body, &more));
            *at = before - REAL(h);
            CHECK_OK(sb_body_set_displacements(body, u));
            CHECK_OK(sb_body_energy(body, &less));
            *at = before;
            force = ((double)more.elastic - (double)less.elastic) / (2 * h);
            force -= held ? 0 : (double)scene_component(forces[i], axis);
            sums[held] += force * force;
        }
    CHECK_OK(sb_body_set_displacements(body, u));
    *free_axes = sqrt(sums[0]);
    *held_axes = sqrt(sums[1]);
    free(u);
}

/* Residual and potential are those of an evaluation that knows nothing of the solver. */
static void test_residual(void)
{
    sb_grid grid = beam_grid();
    sb_body *body = beam_body(&grid, NULL), *other = beam_body(&grid, NULL);
    sb_network *network = network_of(copying(0.8));
    sb_network_info info;
    sb_network_input input;
    sb_energy energy;
    sb_vec3 *u, *forces = (sb_vec3 *)calloc((size_t)grid.mesh.node_count, sizeof(sb_vec3));
    double balance, held, loads = 0, work = 0, off = 0, scale;
    load_beam(body, &grid, sb_v3(0, 0, REAL(-0.015)));
    load_beam(other, &grid, sb_v3(0, 0, REAL(-0.015)));
    solve(other);
    u = shape_of(other);
    memcpy(forces, sb_body_external_forces(other), (size_t)grid.mesh.node_count * sizeof(sb_vec3));
    input = input_of(u, grid.mesh.node_count, SB_NETWORK_TAKE);
    input.limit = 100;
    CHECK_OK(sb_network_predict(network, &grid, body, &input, &info, NULL));
    CHECK(info.taken == 1 && info.from_rest < 0 && info.from_last == info.from_rest && info.size > REAL(0.005));
    for (int i = 0; i < grid.mesh.node_count; i++) {
        sb_vec3 expected = sb_v3_scale(REAL(0.8), u[i]), is = sb_body_displacements(body)[i];
        off = fmax(off, (double)sb_v3_norm(sb_v3_sub(expected, is)));
        loads += (double)sb_v3_dot(forces[i], forces[i]);
        work += (double)sb_v3_dot(forces[i], is);
        if (sb_body_supports(body)[i])
            CHECK(is.x == 0 && is.y == 0 && is.z == 0);
    }
    CHECK_NEAR(off, 0, 1e-6 * (double)info.size); /* floats */
    CHECK_OK(sb_body_energy(body, &energy));
    CHECK_NEAR(info.from_rest, (double)energy.elastic - work, scene_tolerance(1e-9, 100) * work);
    if (!SB_REAL_IS_FLOAT) { /* whose energies have no differences to tell forces by */
        out_of_balance(body, forces, &balance, &held);
        loads = sqrt(loads);
        scale = fmax(loads, fmin(10 * loads, held));
        CHECK_NEAR(info.force, balance, 1e-5 * balance);
        CHECK_NEAR(info.residual, balance / scale, 1e-5 * balance / scale);
    }
    input.limit = info.residual / 2; /* asks for better */
    CHECK_OK(sb_network_predict(network, &grid, other, &input, &info, NULL));
    CHECK(info.taken == 0 && info.from_last > 0); /* which has a lower one */
    sb_body_reset(body);
    CHECK_OK(sb_network_predict(network, &grid, body, &input, &info, NULL));
    CHECK(info.taken == 0 && info.from_last < 0);
    free(u), free(forces);
    sb_network_destroy(network);
    sb_body_destroy(body), sb_body_destroy(other);
    sb_grid_free(&grid);
}

/* Good guesses save iterations, and the answer is the same. */
static void test_starts(void)
{
    sb_grid grid = beam_grid();
    sb_body *plain = beam_body(&grid, NULL), *body = beam_body(&grid, NULL);
    sb_network *network = network_of(copying(0.97));
    sb_network_info info;
    sb_network_input input;
    sb_vec3 *u;
    int without;
    load_beam(plain, &grid, sb_v3(REAL(-0.02), REAL(0.1), REAL(-0.25)));
    load_beam(body, &grid, sb_v3(REAL(-0.02), REAL(0.1), REAL(-0.25)));
    without = solve(plain);
    u = shape_of(plain);
    input = input_of(u, grid.mesh.node_count, SB_NETWORK_START);
    CHECK_OK(sb_network_predict(network, &grid, body, &input, &info, NULL));
    CHECK(info.taken == 1);
    if (!CHECK(info.solve.newton_iterations < without))
        printf("%d iterations, %d without\n", info.solve.newton_iterations, without);
    CHECK_NEAR(distance(plain, body), 0, scene_tolerance(1e-5, 1e4));
    free(u);
    sb_network_destroy(network);
    sb_body_destroy(plain), sb_body_destroy(body);
    sb_grid_free(&grid);
}

/* Whatever a network says: solves end where they end without it, and what is not taken changes nothing. */
static void test_nonsense(void)
{
    sb_grid grid = beam_grid();
    sb_body *plain = beam_body(&grid, NULL), *body = beam_body(&grid, NULL);
    sb_vec3 *u;
    int rounds = check_rounds(10);
    for (int k = 0; k < rounds; k++) {
        unsigned long long seed = 7 + (unsigned long long)k;
        sb_network *network = random_network(seed, 0.02 * (1 << k % 5));
        sb_vec3 force = sb_v3(REAL(check_random_in(&seed, -0.1, 0.1)), REAL(check_random_in(&seed, -0.2, 0.2)),
                              REAL(check_random_in(&seed, -0.2, 0.2)));
        sb_network_info info;
        sb_network_input input;
        int without;
        uint64_t before;
        sb_body_clear_loads(plain), sb_body_clear_loads(body);
        load_beam(plain, &grid, force), load_beam(body, &grid, force);
        if (k % 2)
            sb_body_reset(plain), sb_body_reset(body);
        before = sb_body_state_hash(body);
        without = solve(plain);
        u = shape_of(plain);
        input = input_of(u, 1 + grid.mesh.node_count / 2, SB_NETWORK_KEEP);
        CHECK_OK(sb_network_predict(network, &grid, body, &input, &info, NULL));
        CHECK(!info.taken && info.solve.newton_iterations == 0);
        input.policy = SB_NETWORK_TAKE;
        CHECK_OK(sb_network_predict(network, &grid, body, &input, &info, NULL));
        CHECK(!info.taken && sb_body_state_hash(body) == before);
        input.policy = SB_NETWORK_START;
        CHECK_OK(sb_network_predict(network, &grid, body, &input, &info, NULL));
        CHECK_NEAR(distance(plain, body), 0, scene_tolerance(1e-5, 1e4));
        if (!CHECK(info.solve.newton_iterations <= without + (info.taken ? 1 : 0)))
            printf("%d iterations, %d without, taken %d\n", info.solve.newton_iterations, without, info.taken);
        free(u);
        sb_network_destroy(network);
    }
    sb_body_destroy(plain), sb_body_destroy(body);
    sb_grid_free(&grid);
}

/* Supports that move, and nothing that is known to move. */
static void test_supports(void)
{
    sb_grid grid = beam_grid();
    sb_body *plain = beam_body(&grid, NULL), *body = beam_body(&grid, NULL);
    sb_network *network = network_of(copying(1));
    sb_network_info info;
    sb_vec3 *u, none = sb_v3(0, 0, 0), way = sb_v3(REAL(0.003), 0, REAL(0.02));
    sb_network_input input = input_of(&none, 1, SB_NETWORK_TAKE);
    int last = grid.mesh.node_count - 1;
    CHECK_OK(sb_network_predict(network, &grid, body, &input, &info, NULL));
    CHECK(!info.taken && info.size == 0 && info.from_rest == 0 && info.force < REAL(1e-9));
    CHECK_OK(sb_body_prescribe(plain, &last, 1, SB_XYZ, &way, 1));
    CHECK_OK(sb_body_prescribe(body, &last, 1, SB_XYZ, &way, 1));
    solve(plain);
    u = shape_of(plain);
    input = input_of(u, last, SB_NETWORK_TAKE); /* all but the one that the support moves */
    CHECK_OK(sb_network_predict(network, &grid, body, &input, &info, NULL));
    CHECK(info.taken && info.from_rest < 0 && info.residual < REAL(1e-3));
    CHECK(sb_body_displacements(body)[last].z == way.z);
    sb_body_reset(body);
    input.policy = SB_NETWORK_START;
    CHECK_OK(sb_network_predict(network, &grid, body, &input, &info, NULL));
    CHECK_NEAR(distance(plain, body), 0, scene_tolerance(1e-5, 1e4));
    free(u);
    sb_network_destroy(network);
    sb_body_destroy(plain), sb_body_destroy(body);
    sb_grid_free(&grid);
}

/* What is replayed has the same bits: a start is part of a recording. */
static void test_recorded(void)
{
    sb_grid grid = beam_grid();
    sb_body *body = beam_body(&grid, NULL), *other = beam_body(&grid, NULL);
    sb_network *network = network_of(copying(0.97));
    sb_recording *recording = NULL;
    sb_network_input input;
    sb_vec3 *u;
    load_beam(other, &grid, sb_v3(0, 0, REAL(-0.2)));
    solve(other);
    u = shape_of(other);
    input = input_of(u, grid.mesh.node_count, SB_NETWORK_START);
    sb_body_destroy(other);
    other = beam_body(&grid, NULL);
    CHECK_OK(sb_recording_start(body, 0, NULL, &recording, NULL));
    load_beam(body, &grid, sb_v3(0, 0, REAL(-0.2)));
    CHECK_OK(sb_network_predict(network, &grid, body, &input, NULL, NULL));
    sb_recording_stop(recording);
    CHECK_OK(sb_recording_replay(recording, other, NULL));
    CHECK(sb_body_state_hash(body) == sb_body_state_hash(other));
    sb_recording_destroy(recording);
    free(u);
    sb_network_destroy(network);
    sb_body_destroy(body), sb_body_destroy(other);
    sb_grid_free(&grid);
}

static void refuse(sb_network *network, const sb_grid *grid, sb_body *body, const sb_network_input *input,
                   sb_result expected)
{
    sb_error error;
    uint64_t before = sb_body_state_hash(body);
    CHECK_RESULT(sb_network_predict(network, grid, body, input, NULL, &error), expected);
    CHECK(error.result == expected && error.message[0] && sb_body_state_hash(body) == before);
}

static void test_bad_input(void)
{
    sb_grid grid = beam_grid(), wrong = grid;
    sb_body *body = beam_body(&grid, NULL);
    sb_network *network = network_of(copying(1)), *tiny = NULL, *hard = NULL;
    network_file file = copying(1);
    sb_vec3 u = sb_v3(REAL(0.001), 0, 0), bad = sb_v3((sb_real)NAN, 0, 0);
    int node = grid.mesh.node_count;
    sb_network_input input = input_of(&u, 1, SB_NETWORK_TAKE), changed;
    sb_network *other = random_network(3, 0.1);
    check_bad_numbers();
    refuse(network, NULL, body, &input, SB_ERROR_ARGUMENT);
    refuse(network, &grid, body, NULL, SB_ERROR_ARGUMENT);
    refuse(NULL, &grid, body, &input, SB_ERROR_ARGUMENT);
    memset(&changed, 0, sizeof changed);
    refuse(network, &grid, body, &changed, SB_ERROR_ARGUMENT);
    changed = input, changed.count = 0;
    refuse(network, &grid, body, &changed, SB_ERROR_ARGUMENT);
    changed = input, changed.count = node + 1;
    refuse(network, &grid, body, &changed, SB_ERROR_ARGUMENT);
    changed = input, changed.displacements = NULL;
    refuse(network, &grid, body, &changed, SB_ERROR_ARGUMENT);
    changed = input, memset(&changed.policy, 1, sizeof changed.policy); /* of no kind */
    refuse(network, &grid, body, &changed, SB_ERROR_ARGUMENT);
    changed = input, changed.limit = (sb_real)NAN;
    refuse(network, &grid, body, &changed, SB_ERROR_ARGUMENT);
    changed = input, changed.nodes = &node;
    refuse(network, &grid, body, &changed, SB_ERROR_INDEX);
    changed = input, changed.displacements = &bad;
    refuse(network, &grid, body, &changed, SB_ERROR_NOT_FINITE);
    wrong.mesh.node_count--;
    refuse(network, &wrong, body, &input, SB_ERROR_ARGUMENT);
    wrong = grid, wrong.cell_size.y *= REAL(1.01);
    refuse(network, &wrong, body, &input, SB_ERROR_ARGUMENT);
    wrong = grid, wrong.counts[2] = 8;
    refuse(network, &wrong, body, &input, SB_ERROR_ARGUMENT);
    network_put_float(file.bytes + 40, 0.3f);
    network_seal(file.bytes, file.size);
    CHECK_OK(sb_network_load_memory(file.bytes, file.size, NULL, &hard, NULL));
    refuse(hard, &grid, body, &input, SB_ERROR_MATERIAL);
    network_file_free(&file);
    file = network_begin(16, 8, 8, 3);
    {
        unsigned long long random = 1;
        network_add(&file, SB_LAYER_CONVOLUTION, 1, 0, 3, SB_ACTIVATION_NONE, 1, &random);
    }
    network_end(&file);
    CHECK_OK(sb_network_load_memory(file.bytes, file.size, NULL, &tiny, NULL));
    refuse(tiny, &grid, body, &input, SB_ERROR_UNSUPPORTED);
    network_file_free(&file);
    sb_network_destroy(tiny), sb_network_destroy(hard), sb_network_destroy(network), sb_network_destroy(other);
    sb_body_destroy(body);
    sb_grid_free(&grid);
}

/* TAKE and KEEP allocate nothing; START gets by without what it asks for. */
static void test_memory(void)
{
    scene_memory memory;
    sb_allocator allocator = scene_allocator(&memory);
    sb_grid grid = beam_grid();
    sb_body *body, *plain = beam_body(&grid, NULL);
    sb_network *network = network_of(copying(0.97));
    sb_network_info info;
    sb_network_input input;
    sb_vec3 *u;
    int live, calls;
    memset(&memory, 0, sizeof memory);
    body = beam_body(&grid, &allocator);
    load_beam(plain, &grid, sb_v3(0, 0, REAL(-0.1)));
    load_beam(body, &grid, sb_v3(0, 0, REAL(-0.1)));
    solve(plain);
    u = shape_of(plain);
    input = input_of(u, grid.mesh.node_count, SB_NETWORK_TAKE);
    calls = memory.calls;
    CHECK_OK(sb_network_predict(network, &grid, body, &input, &info, NULL));
    CHECK(memory.calls == calls);
    live = memory.live;
    input.policy = SB_NETWORK_START;
    for (int n = 1; n < 20; n++) {
        sb_body_reset(body);
        memory.calls = 0;
        memory.fail_at = n;
        CHECK_OK(sb_network_predict(network, &grid, body, &input, &info, NULL));
        CHECK_NEAR(distance(plain, body), 0, scene_tolerance(1e-5, 1e4));
        CHECK_INT(memory.live, live);
        if (memory.calls < n)
            break;
    }
    memory.fail_at = 0;
    free(u);
    sb_network_destroy(network);
    sb_body_destroy(body), sb_body_destroy(plain);
    CHECK_INT(memory.live, 0);
    sb_grid_free(&grid);
}

CHECK_SUITE(network_predict, {"residual", test_residual}, {"starts", test_starts}, {"nonsense", test_nonsense},
            {"supports", test_supports}, {"recorded", test_recorded}, {"bad input", test_bad_input},
            {"memory", test_memory});
