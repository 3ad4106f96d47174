/* Needles and tools on one organ: forces balance, nothing that one does is lost on the other, and states, recordings
 * and steps taken back hold both. Generated scenes. */
#define SB_SPLIT_BUILD
#include "../src/needle/needle_private.h"
#include "../src/softbody/contact/contact_private.h"

#include "contact_scene.h"
#include "needle_scene.h"

/* A needle scene whose body a ball touches as well. */
typedef struct scene {
    needle_scene needles;
    sb_contact *contact;
    int ball;
    double radius;
    int workers;
    sb_mesh surface; /* what the ball touches in place of the body's boundary, or zeros */
    sb_embedding *embedding;
    sb_skin *skin;
    sb_cut *knife;
} scene;

static sb_vec3 placed(const scene *s, double x, double y, double z)
{
    sb_vec3 at = sb_v3(REAL(x), REAL(y), REAL(z));
    return s->needles.turned ? needle_scene_placed(at) : at;
}

/* A block of a random material, turned or not, a bevelled needle above it and a ball of random size beside that; equal
 * seeds make equal scenes. */
static int make_scene_of(scene *s, int number, int workers)
{
    unsigned long long seed = 500 + (unsigned long long)number;
    sb_contact_def def = sb_default_contact_def();
    sb_tool_def ball;
    needle_scene *n = &s->needles;
    memset(s, 0, sizeof *s);
    *n = needle_scene_default();
    s->workers = workers;
    n->body_def.jobs = scene_jobs(&s->workers);
    n->turned = check_random(&seed) < 0.5;
    n->shake = check_random_in(&seed, 0, 0.2);
    n->materials[0].young = REAL(check_random_in(&seed, 1e4, 8e4));
    n->materials[0].poisson = REAL(check_random_in(&seed, 0, 0.45));
    n->body_def.integrator = check_random(&seed) < 0.5 ? SB_EULER : SB_GENERALISED_ALPHA;
    n->body_def.max_newton = check_random(&seed) < 0.7 ? 1 : 4;
    n->needle_def.bevel.curvature = REAL(check_random_in(&seed, 0, 10));
    if (!needle_scene_make(n))
        return 0;
    def.body = n->body;
    if (!CHECK_OK(sb_contact_create(&def, &s->contact, NULL)))
        return 0;
    s->radius = check_random_in(&seed, 0.004, 0.009);
    ball = press_sphere(s->radius, check_random_in(&seed, 0, 0.8), placed(s, 0.012, 0.02, 0.041 + s->radius));
    return CHECK_OK(sb_contact_add_tool(s->contact, &ball, &s->ball, NULL));
}

static int make_scene(scene *s, int number) { return make_scene_of(s, number, 1); }

static void free_scene(scene *s)
{
    sb_contact_destroy(s->contact);
    sb_skin_destroy(s->skin);
    sb_cut_destroy(s->knife);
    sb_embedding_destroy(s->embedding);
    sb_mesh_free(&s->surface);
    needle_scene_free(&s->needles);
}

/* The needle goes in, about and out, while the ball presses and slides over the place where it went in. What happens
 * depends on the seed and the step's number alone. */
static sb_result random_step(scene *s, int seed, int number)
{
    unsigned long long draw = 1000003ull * (unsigned long long)seed + (unsigned long long)number;
    double phase = (number % 40) / 40.0, deep = 0.003 * sin(3.14159265 * phase);
    double x = 0.012 + 0.016 * phase, y = 0.02 + check_random_in(&draw, -5e-4, 5e-4);
    sb_pose pose = press_pose(placed(s, x, y, 0.0405 + s->radius - deep), sb_quat_identity());
    ndl_command command = needle_command(number % 36 < 14   ? check_random_in(&draw, 0.02, 0.08)
                                         : number % 36 < 22 ? check_random_in(&draw, -0.01, 0.01)
                                                            : -check_random_in(&draw, 0.02, 0.1),
                                         check_random_in(&draw, -1, 1));
    CHECK_OK(sb_contact_move_tool(s->contact, s->ball, &pose));
    return ndl_step(s->needles.body, s->needles.needles, s->needles.count, REAL(0.02), &command, &s->needles.info,
                    &s->needles.error);
}

static sb_vec3 wrench_of(const scene *s)
{
    sb_wrench wrench = {{0, 0, 0}, {0, 0, 0}};
    CHECK_OK(sb_contact_wrench(s->contact, s->ball, &wrench));
    return wrench.force;
}

static unsigned long long bits(const scene *s)
{
    sb_vec3 force = wrench_of(s);
    return needle_scene_bits(&s->needles) * 31 + scene_hash(&force, sizeof force);
}

/* Steps of one after the other; counts those that failed, which change nothing. */
static int random_steps(scene *s, int seed, int from, int to)
{
    int failed = 0;
    for (int i = from; i < to; i++) {
        uint64_t before = sb_body_state_hash(s->needles.body);
        if (random_step(s, seed, i) == SB_OK)
            continue;
        failed++;
        printf("  seed %d, step %d: %s\n", seed, i, s->needles.error.message);
        CHECK(sb_body_state_hash(s->needles.body) == before);
    }
    return failed;
}

/* ---- both at once ---- */

static void test_random(void)
{
    int scenes = check_rounds(30), both = 0;
    for (int seed = 0; seed < scenes; seed++) {
        scene s;
        if (!make_scene(&s, seed))
            return;
        for (int i = 0; i < 40; i++) {
            CHECK_INT(random_steps(&s, seed, i, i + 1), 0);
            both += ndl_needle_depth(s.needles.needles[0]) > 0 && sb_v3_norm(wrench_of(&s)) > 0;
        }
        CHECK(needle_scene_is_sound(&s.needles));
        free_scene(&s);
    }
    CHECK(both > 5 * scenes);
}

/* What supports, sleeve and ball exert on organ and needle, about a point: at rest nothing. */
static sb_wrench balance_of(const scene *s, sb_vec3 about)
{
    const ndl_needle *needle = s->needles.needles[0];
    sb_vec3 sleeve, turn, outlet = ndl_rod_positions(ndl_needle_rod(needle))[1];
    sb_pose ball;
    sb_wrench on_ball, sum = {{0, 0, 0}, {0, 0, 0}};
    for (int i = 0; i < sb_body_node_count(s->needles.body); i++) {
        sb_vec3 arm = sb_v3_sub(sb_body_positions(s->needles.body)[i], about);
        sum.force = sb_v3_add(sum.force, sb_body_reactions(s->needles.body)[i]);
        sum.torque = sb_v3_add(sum.torque, sb_v3_cross(arm, sb_body_reactions(s->needles.body)[i]));
    }
    ndl_needle_base_wrench(needle, &sleeve, &turn);
    sum.force = sb_v3_add(sum.force, sleeve);
    sum.torque = sb_v3_add(sum.torque, sb_v3_add(turn, sb_v3_cross(sb_v3_sub(outlet, about), sleeve)));
    CHECK_OK(sb_contact_wrench(s->contact, s->ball, &on_ball));
    CHECK_OK(sb_contact_reached(s->contact, s->ball, &ball, NULL));
    on_ball.torque = sb_v3_add(on_ball.torque, sb_v3_cross(sb_v3_sub(ball.position, about), on_ball.force));
    sum.force = sb_v3_sub(sum.force, on_ball.force);
    sum.torque = sb_v3_sub(sum.torque, on_ball.torque);
    return sum;
}

/* At rest supports, sleeve and ball hold the organ together. */
static void test_balance(void)
{
    for (int seed = 0; seed < 6; seed++) {
        scene s;
        sb_wrench left;
        sb_vec3 sleeve;
        sb_pose pose;
        ndl_command none = needle_command(0, 0);
        double most;
        if (!make_scene(&s, seed))
            return;
        random_steps(&s, seed, 0, 12);
        CHECK_OK(sb_body_set_solver(s.needles.body, sb_max(REAL(1e-11), 100 * SB_EPSILON), 3000));
        pose.position = placed(&s, 0.018, 0.02, 0.0385 + s.radius);
        pose.rotation = sb_quat_identity();
        for (int i = 0; i < 300; i++) {
            CHECK_OK(sb_contact_move_tool(s.contact, s.ball, &pose));
            CHECK_OK(ndl_step(s.needles.body, s.needles.needles, 1, REAL(0.05), &none, NULL, NULL));
        }
        ndl_needle_base_wrench(s.needles.needles[0], &sleeve, NULL);
        most = (double)sb_v3_norm(wrench_of(&s));
        CHECK(most > 0.01 && (double)sb_v3_norm(sleeve) > 0.01);
        left = balance_of(&s, placed(&s, 0.02, 0.02, 0.02));
        printf("  seed %d: %.1e of %.3g N, %.1e of a lever of 20 mm\n", seed, (double)sb_v3_norm(left.force) / most,
               most, (double)sb_v3_norm(left.torque) / (0.02 * most));
        CHECK_NEAR(sb_v3_norm(left.force), 0, scene_tolerance(1e-8, 1e5) * most);
        CHECK_NEAR(sb_v3_norm(left.torque), 0, scene_tolerance(1e-8, 1e5) * 0.02 * most);
        free_scene(&s);
    }
}

static void test_threads(void)
{
    for (int seed = 0; seed < check_rounds(5); seed++) {
        unsigned long long one = 0;
        for (int workers = 1; workers < 5; workers += 2) {
            scene s;
            if (!make_scene_of(&s, seed, workers))
                return;
            random_steps(&s, seed, 0, 20);
            if (workers == 1)
                one = bits(&s);
            CHECK(bits(&s) == one);
            free_scene(&s);
        }
    }
}

/* ---- states and recordings ---- */

/* What follows a load is what followed the save, bit for bit, in mid-insertion and under the ball. */
static void test_states(void)
{
    for (int seed = 0; seed < check_rounds(10); seed++) {
        scene a, b;
        size_t size;
        void *image;
        unsigned long long expected;
        int cut = 6 + 3 * seed % 20;
        if (!make_scene(&a, seed) || !make_scene(&b, seed))
            return;
        random_steps(&a, seed, 0, cut);
        size = sb_body_state_size(a.needles.body);
        image = malloc(size);
        CHECK_OK(sb_body_state_save(a.needles.body, image, size));
        random_steps(&a, seed, cut, cut + 8);
        expected = bits(&a);
        random_steps(&b, seed + 1, 0, 9); /* wherever it is */
        CHECK_OK(sb_body_state_load(b.needles.body, image, size, NULL));
        random_steps(&b, seed, cut, cut + 8);
        CHECK(bits(&b) == expected);
        CHECK_OK(sb_body_state_load(a.needles.body, image, size, NULL));
        random_steps(&a, seed, cut, cut + 8);
        CHECK(bits(&a) == expected);
        free(image);
        free_scene(&a);
        free_scene(&b);
    }
}

static void test_recordings(void)
{
    for (int seed = 0; seed < check_rounds(10); seed++) {
        scene a, b;
        sb_recording *recording = NULL;
        sb_recording_report report;
        if (!make_scene(&a, seed) || !make_scene(&b, seed))
            return;
        random_steps(&a, seed, 0, seed);
        CHECK_OK(sb_recording_start(a.needles.body, 5, NULL, &recording, NULL));
        random_steps(&a, seed, seed, 30);
        sb_recording_stop(recording);
        if (!CHECK_OK(sb_recording_replay(recording, b.needles.body, &report)))
            printf("%s\n", report.error.message);
        CHECK(bits(&a) == bits(&b));
        sb_recording_destroy(recording);
        free_scene(&a);
        free_scene(&b);
    }
}

/* ---- steps that needles divide ---- */

/* A surface of its own at height z, of side by side points and finer than the mesh. */
static void make_surface(scene *s, int side, double z)
{
    sb_mesh *m = &s->surface;
    int quads = side - 1;
    m->element_type = SB_TRI3;
    m->nodes = (sb_vec3 *)calloc((size_t)(side * side), sizeof *m->nodes);
    m->elements = (int *)calloc((size_t)(6 * quads * quads), sizeof(int));
    for (int j = 0; j < side; j++)
        for (int i = 0; i < side; i++)
            m->nodes[m->node_count++] = placed(s, 0.002 + 0.036 * i / quads, 0.002 + 0.036 * j / quads, z);
    for (int k = 0; k < quads * quads; k++) {
        int at = k / quads * side + k % quads, *t = m->elements + 3 * m->element_count;
        t[0] = at, t[1] = at + 1, t[2] = at + side + 1;
        t[3] = at, t[4] = at + side + 1, t[5] = at + side;
        m->element_count += 2;
    }
}

/* It goes with the body. */
static sb_skin *embed_skin(scene *s, sb_embedding_kind kind)
{
    sb_embedding_def def = sb_default_embedding_def();
    def.mesh = &s->needles.mesh;
    def.surface = &s->surface;
    def.kind = kind;
    def.allocator = s->needles.body_def.allocator;
    CHECK_OK(sb_embedding_create(&def, &s->embedding, NULL));
    CHECK_OK(sb_embedding_follow(s->embedding, s->needles.body, NULL));
    CHECK_OK(sb_skin_create(s->embedding, &s->surface, NULL, &s->skin, NULL));
    return s->skin;
}

/* One just below the block's top. */
static sb_skin *make_skin(scene *s)
{
    make_surface(s, 13, 0.0399);
    return embed_skin(s, SB_EMBED_SMOOTH);
}

/* A layered block with a skin and a membrane between its layers, a needle above it and a ball beside that. strength: of
 * the membranes (N), 0: there are none; memory NULL: malloc's. */
static int make_divided(scene *s, ndl_follow follow, double strength, int skinned, unsigned long long seed,
                        scene_memory *memory)
{
    ndl_membrane membranes[2];
    sb_contact_def def = sb_default_contact_def();
    sb_tool_def ball;
    needle_scene *n = &s->needles;
    memset(s, 0, sizeof *s);
    *n = needle_scene_default();
    for (int i = 0; i < 2; i++) {
        membranes[i].regions[0] = i - 1, membranes[i].regions[1] = i;
        membranes[i].strength = REAL(strength);
        membranes[i].thickness = REAL(check_random_in(&seed, 2e-4, 1e-3));
        n->materials[i].young = REAL(check_random_in(&seed, 3e4, 8e4));
    }
    n->layered = 1;
    n->turned = check_random(&seed) < 0.5;
    n->needle_def.follow = follow;
    n->body_def.integrator = check_random(&seed) < 0.5 ? SB_EULER : SB_GENERALISED_ALPHA;
    n->needle_def.membranes = strength > 0 ? membranes : NULL;
    n->needle_def.membrane_count = strength > 0 ? 2 : 0;
    n->needle_def.base.z = REAL(0.0905);
    n->body_def.slack = 1;
    if (memory)
        n->body_def.allocator = n->needle_def.allocator = scene_allocator(memory);
    if (!needle_scene_make(n))
        return 0;
    def.body = n->body;
    def.skin = skinned ? make_skin(s) : NULL;
    if (!CHECK_OK(sb_contact_create(&def, &s->contact, NULL)))
        return 0;
    s->radius = check_random_in(&seed, 0.004, 0.007);
    ball = press_sphere(s->radius, check_random_in(&seed, 0.2, 0.8), placed(s, 0.008, 0.02, 0.0405 + s->radius));
    return CHECK_OK(sb_contact_add_tool(s->contact, &ball, &s->ball, NULL));
}

/* The ball goes down beside the needle, then slides, `aside` (m) of all that; at the end of step `number`. */
static sb_vec3 place_of_ball(const scene *s, int number, double aside)
{
    double deep = number < 8 ? 0.00025 * number : 0.002, along = number < 8 ? 0 : 0.0004 * (number - 8);
    return placed(s, 0.008, 0.014 + along, 0.0405 + s->radius - deep + aside);
}

static void send_ball_to(scene *s, sb_vec3 place)
{
    sb_pose pose = press_pose(place, sb_quat_identity());
    CHECK_OK(sb_contact_move_tool(s->contact, s->ball, &pose));
}

static void send_ball(scene *s, int number, double aside) { send_ball_to(s, place_of_ball(s, number, aside)); }

/* The needle goes in by 40 mm/s. */
static sb_result divided_step(scene *s, int number, double aside)
{
    ndl_command command = needle_command(0.04, 0);
    send_ball(s, number, aside);
    return ndl_step(s->needles.body, s->needles.needles, s->needles.count, REAL(0.02), &command, &s->needles.info,
                    &s->needles.error);
}

static void check_has_arrived(const scene *s)
{
    sb_real lag = 1;
    CHECK_OK(sb_contact_reached(s->contact, s->ball, NULL, &lag));
    CHECK_NEAR(lag, 0, scene_tolerance(1e-9, 1e4));
}

/* Membranes that resist by next to nothing divide steps, and change nothing of what the ball feels but for what shorter
 * steps do; there or not, it is where it was sent. */
static void check_divided(ndl_follow follow, unsigned long long seed, int *divided)
{
    scene with, without;
    double most = 0, off = 0;
    if (!make_divided(&with, follow, 1e-6, 0, seed, NULL) || !make_divided(&without, follow, 0, 0, seed, NULL))
        return;
    for (int i = 0; i < 26; i++) {
        sb_vec3 a, b;
        CHECK_OK(divided_step(&with, i, 0));
        CHECK_OK(divided_step(&without, i, 0));
        check_has_arrived(&with);
        *divided += with.needles.info.substeps > 1;
        CHECK_INT(without.needles.info.substeps, 1);
        a = wrench_of(&with), b = wrench_of(&without);
        most = fmax(most, (double)sb_v3_norm(b));
        off = fmax(off, (double)sb_v3_norm(sb_v3_sub(a, b)));
    }
    if (!CHECK(off < 0.1 * most))
        printf("    seed %llu: %g of %g N\n", seed, off, most);
    free_scene(&with);
    free_scene(&without);
}

static void test_divided(void)
{
    int divided = 0;
    for (int k = 0; k < check_rounds(8); k++)
        check_divided(k % 2 ? NDL_REMESH : NDL_EMBED, 60 + (unsigned)k, &divided);
    CHECK(divided > 0);
}

/* The same motion in steps of an eighth. */
static void step_finely(scene *s, int number)
{
    const int parts = 8;
    ndl_command command = needle_command(0.04, 0);
    for (int k = 1; k <= parts; k++) {
        sb_vec3 from = place_of_ball(s, number ? number - 1 : 0, 0), to = place_of_ball(s, number, 0);
        send_ball_to(s, sb_v3_madd(from, REAL(k) / REAL(parts), sb_v3_sub(to, from)));
        CHECK_OK(ndl_step(s->needles.body, s->needles.needles, 1, REAL(0.02) / REAL(parts), &command, NULL, NULL));
    }
}

/* What a ball feels in a divided step differs by up to 8 % of the peak from that of an undivided one, and that is what
 * the long step is off by: shorter steps have it, too. */
static void test_nearer(void)
{
    int divided = 0;
    for (int k = 0; k < check_rounds(4); k++) {
        scene with, without, fine;
        ndl_follow follow = k % 2 ? NDL_REMESH : NDL_EMBED;
        double most = 0, nearer = 0, farther = 0;
        if (!make_divided(&with, follow, 1e-6, 0, 60 + (unsigned)k, NULL) ||
            !make_divided(&without, follow, 0, 0, 60 + (unsigned)k, NULL) ||
            !make_divided(&fine, follow, 0, 0, 60 + (unsigned)k, NULL))
            return;
        for (int i = 0; i < 26; i++) {
            double off, undivided;
            CHECK_OK(divided_step(&with, i, 0));
            CHECK_OK(divided_step(&without, i, 0));
            step_finely(&fine, i);
            off = (double)sb_v3_norm(sb_v3_sub(wrench_of(&with), wrench_of(&fine)));
            undivided = (double)sb_v3_norm(sb_v3_sub(wrench_of(&without), wrench_of(&fine)));
            most = fmax(most, (double)sb_v3_norm(wrench_of(&fine)));
            nearer = fmax(nearer, undivided - off);
            farther = fmax(farther, off - undivided);
            divided += with.needles.info.substeps > 1;
        }
        printf("seed %d: divided steps nearer to fine ones by %.1f %%, farther by %.1f %%\n", 60 + k,
               100 * nearer / most, 100 * farther / most);
        CHECK(farther < 0.01 * most);
        free_scene(&with);
        free_scene(&without);
        free_scene(&fine);
    }
    CHECK(divided > 0);
}

/* A ball that touches nothing changes nothing, however steps are divided. */
static void test_apart(void)
{
    for (int k = 0; k < check_rounds(4); k++) {
        scene moving, resting;
        int divided = 0;
        ndl_follow follow = k % 2 ? NDL_REMESH : NDL_EMBED;
        if (!make_divided(&moving, follow, 1, 0, 90 + (unsigned)k, NULL) ||
            !make_divided(&resting, follow, 1, 0, 90 + (unsigned)k, NULL))
            return;
        sb_contact_destroy(resting.contact);
        resting.contact = NULL;
        for (int i = 0; i < 26; i++) {
            ndl_command command = needle_command(0.04, 0);
            CHECK_OK(divided_step(&moving, i, 0.05));
            CHECK_OK(ndl_step(resting.needles.body, resting.needles.needles, 1, REAL(0.02), &command, NULL, NULL));
            check_has_arrived(&moving);
            divided += moving.needles.info.substeps > 1;
            CHECK(needle_scene_bits(&moving.needles) == needle_scene_bits(&resting.needles));
        }
        CHECK(divided > 0);
        free_scene(&moving);
        free_scene(&resting);
    }
}

static void test_no_memory_taken(void)
{
    for (int k = 0; k < check_rounds(4); k++) {
        scene_memory memory = {0, 0, 0, 0};
        scene s;
        if (!make_divided(&s, k % 2 ? NDL_REMESH : NDL_EMBED, 0.5, 0, 30 + (unsigned)k, &memory))
            return;
        memory.calls = 0; /* not in the first step either: what comes later has brought its room */
        for (int i = 0; i < 26; i++) {
            CHECK_OK(divided_step(&s, i, 0));
            if (!CHECK(memory.calls == 0))
                printf("    scene %d, step %d: %d\n", k, i, memory.calls);
            memory.calls = 0;
        }
        free_scene(&s);
        CHECK_INT(memory.live, 0);
    }
}

/* Each allocation of a contact, and of a tool, beside a needle fails in turn, and leaves nothing behind. */
static void test_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    scene s;
    sb_contact_def def = sb_default_contact_def();
    sb_tool_def ball = press_sphere(0.004, 0.3, sb_v3(REAL(0.008), REAL(0.02), REAL(0.05)));
    sb_result result[2] = {SB_ERROR_MEMORY, SB_ERROR_MEMORY};
    memset(&s, 0, sizeof s);
    s.needles = needle_scene_default();
    s.needles.body_def.allocator = s.needles.needle_def.allocator = scene_allocator(&memory);
    if (!needle_scene_make(&s.needles))
        return;
    def.body = s.needles.body;
    for (int k = 0; k < 2; k++) {
        for (int n = 1; n < 100 && result[k] != SB_OK; n++) {
            int live = memory.live;
            memory.calls = 0;
            memory.fail_at = n;
            result[k] =
                k ? sb_contact_add_tool(s.contact, &ball, &s.ball, NULL) : sb_contact_create(&def, &s.contact, NULL);
            CHECK(result[k] == SB_OK || (result[k] == SB_ERROR_MEMORY && memory.live <= live + 4));
        }
        memory.fail_at = 0;
        if (!CHECK_OK(result[k]))
            break;
    }
    memory.calls = 0;
    CHECK_OK(ndl_step(s.needles.body, s.needles.needles, s.needles.count, REAL(0.02), NULL, NULL, NULL));
    CHECK_INT(memory.calls, 0);
    free_scene(&s);
    CHECK_INT(memory.live, 0);
}

/* Supports that go evenly do so in the parts of a step, too: at its end they have the speed of their way. */
static void test_supports(void)
{
    int divided = 0;
    for (int k = 0; k < check_rounds(4); k++) {
        scene s;
        sb_body *body;
        int node = -1;
        if (!make_divided(&s, k % 2 ? NDL_REMESH : NDL_EMBED, 0.5, 0, 10 + (unsigned)k, NULL))
            return;
        body = s.needles.body;
        while (sb_body_supports(body)[++node] != SB_XYZ)
            continue;
        for (int i = 0; i < 26; i++) {
            sb_vec3 way = sb_v3(REAL(1e-5), REAL(-2e-5), REAL(3e-5)), goal = sb_v3_scale((sb_real)(i + 1), way);
            CHECK_OK(sb_body_prescribe(body, &node, 1, SB_XYZ, &goal, 0));
            CHECK_OK(divided_step(&s, i, 0));
            divided += s.needles.info.substeps > 1;
            if (!CHECK_NEAR(sb_v3_norm(sb_v3_sub(sb_body_velocities(body)[node], sb_v3_scale(REAL(50), way))), 0,
                            scene_tolerance(1e-9, 1e6)))
                printf("    scene %d, step %d of %d parts\n", k, i, s.needles.info.substeps);
        }
        free_scene(&s);
    }
    CHECK(divided > 0);
}

/* ---- skins whose points have been placed anew ---- */

/* The block's own boundary, its points moved by up to `shake` (m). */
static sb_skin *make_shaken_skin(scene *s, double shake, sb_embedding_kind kind, unsigned long long *seed)
{
    sb_boundary boundary;
    CHECK_OK(sb_mesh_boundary(&s->needles.mesh, 1, NULL, &boundary, NULL));
    CHECK_OK(sb_mesh_copy(&boundary.surface, NULL, &s->surface, NULL));
    sb_boundary_free(&boundary);
    for (int i = 0; i < s->surface.node_count; i++) {
        sb_vec3 off = sb_v3(REAL(check_random_in(seed, -shake, shake)), REAL(check_random_in(seed, -shake, shake)),
                            REAL(check_random_in(seed, -shake, shake)));
        s->surface.nodes[i] = sb_v3_add(s->surface.nodes[i], off);
    }
    return embed_skin(s, kind);
}

/* A block with such a skin, a needle above it, a ball beside that, and a knife where needles allow it. crowd: small
 * organs that fall on the block and touch it and each other, or NULL. */
static int make_crowd(scene *s, ndl_follow follow, unsigned long long seed, scene_memory *memory, const sb_mesh *crowd)
{
    sb_contact_def def = sb_default_contact_def();
    sb_cut_def cut = sb_default_cut_def();
    sb_tool_def ball;
    needle_scene *n = &s->needles;
    memset(s, 0, sizeof *s);
    *n = needle_scene_default();
    n->turned = check_random(&seed) < 0.5;
    n->shake = check_random_in(&seed, 0, 0.2);
    n->cells[0] = n->cells[1] = n->cells[2] = 6;
    n->body_def.slack = 1;
    n->body_def.integrator = check_random(&seed) < 0.5 ? SB_EULER : SB_GENERALISED_ALPHA;
    n->materials[0].young = REAL(check_random_in(&seed, 1e4, 8e4));
    n->needle_def.follow = follow;
    if (memory)
        n->body_def.allocator = n->needle_def.allocator = scene_allocator(memory);
    n->beside = crowd;
    if (crowd) {
        def.pairs = SB_CONTACT_ORGANS;
        def.pair_friction = REAL(0.3);
        n->body_def.gravity = sb_v3_scale(REAL(-9.81), sb_v3_sub(placed(s, 0, 0, 1), placed(s, 0, 0, 0)));
    }
    if (!needle_scene_make(n))
        return 0;
    def.body = cut.body = n->body;
    def.skin = make_shaken_skin(s, check_random(&seed) < 0.5 ? 0 : 1e-3,
                                check_random(&seed) < 0.5 ? SB_EMBED_PLAIN : SB_EMBED_SMOOTH, &seed);
    if (!CHECK_OK(sb_contact_create(&def, &s->contact, NULL)) ||
        (follow == NDL_EMBED && !CHECK_OK(sb_cut_create(&cut, &s->knife, NULL))))
        return 0;
    s->radius = check_random_in(&seed, 0.004, 0.009);
    ball = press_sphere(s->radius, check_random_in(&seed, 0, 0.8), placed(s, 0.012, 0.02, 0.041 + s->radius));
    return CHECK_OK(sb_contact_add_tool(s->contact, &ball, &s->ball, NULL));
}

static int make_skinned(scene *s, ndl_follow follow, unsigned long long seed, scene_memory *memory)
{
    return make_crowd(s, follow, seed, memory, NULL);
}

/* A random step; the knife goes through a corner of the block before some. */
static sb_result skinned_step(scene *s, int seed, int number)
{
    if (s->knife && number % 8 == 5) {
        double x = 0.004 + 0.0011 * number;
        sb_vec3 plane[3];
        plane[0] = placed(s, x, -1, 0.031), plane[1] = placed(s, x + 0.001, 1, 0.03), plane[2] = placed(s, x, 0, 2);
        CHECK_OK(sb_cut_triangles(s->knife, plane, 1, NULL, NULL));
    }
    return random_step(s, seed, number);
}

/* Where the skins are drawn. */
static int has_same_skin(const scene *a, const scene *b)
{
    size_t count = (size_t)a->surface.node_count;
    sb_vec3 *drawn = (sb_vec3 *)malloc(2 * count * sizeof *drawn);
    int same;
    CHECK_OK(sb_embedding_update(a->embedding, sb_body_positions(a->needles.body), drawn, NULL, NULL));
    CHECK_OK(sb_embedding_update(b->embedding, sb_body_positions(b->needles.body), drawn + count, NULL, NULL));
    same = memcmp(drawn, drawn + count, count * sizeof *drawn) == 0;
    free(drawn);
    return same;
}

/* Each step from a state that was just loaded, into a scene that is some steps behind, is that of the scene that went
 * on: motion, forces, and where the skin is drawn. */
static int follow_by_states(scene *a, scene *b, int seed, int steps)
{
    unsigned long long draw = 77 + (unsigned)seed;
    int same = 1;
    for (int i = 0; i < steps && same; i++) {
        size_t size = sb_body_state_size(a->needles.body);
        void *image;
        sb_result one, other;
        if (check_random(&draw) < 0.6) {
            skinned_step(a, seed, i);
            continue;
        }
        image = malloc(size);
        CHECK_OK(sb_body_state_save(a->needles.body, image, size));
        CHECK_OK(sb_body_state_load(b->needles.body, image, size, NULL));
        same &= CHECK(sb_body_state_hash(a->needles.body) == sb_body_state_hash(b->needles.body));
        free(image);
        one = skinned_step(a, seed, i);
        other = skinned_step(b, seed, i);
        same &= CHECK(one == other && bits(a) == bits(b));
        same &= CHECK(has_same_skin(a, b));
        if (!same)
            printf("    seed %d, step %d\n", seed, i);
    }
    return same;
}

static void test_skin_states(void)
{
    for (int k = 0; k < check_rounds(4); k++) {
        scene a, b;
        ndl_follow follow = k % 2 ? NDL_EMBED : NDL_REMESH;
        if (!make_skinned(&a, follow, 40 + (unsigned)k, NULL) || !make_skinned(&b, follow, 40 + (unsigned)k, NULL))
            return;
        follow_by_states(&a, &b, k, 24);
        free_scene(&a);
        free_scene(&b);
    }
}

/* Two cubes of 9 mm above a corner of the block, where neither needle nor ball comes, one on the other. */
static sb_mesh make_two_cubes(void)
{
    sb_vec3 size = sb_v3(REAL(0.009), REAL(0.009), REAL(0.009));
    sb_mesh lower = scene_box(SB_TET4, 2, 2, 2, size, 0.1), upper = scene_box(SB_TET4, 3, 2, 2, size, 0.1);
    for (int i = 0; i < lower.node_count; i++)
        lower.nodes[i] = sb_v3_add(lower.nodes[i], sb_v3(REAL(0.005), REAL(0.027), REAL(0.0425)));
    for (int i = 0; i < upper.node_count; i++)
        upper.nodes[i] = sb_v3_add(upper.nodes[i], sb_v3(REAL(0.007), REAL(0.025), REAL(0.054)));
    CHECK_OK(sb_mesh_append(&lower, &upper, NULL));
    sb_mesh_free(&upper);
    return lower;
}

/* Bits of all that touches; *organs: how many of these points are of two organs. */
static unsigned long long points_of(const scene *s, int *organs)
{
    int count = sb_contact_points(s->contact, NULL, 0);
    sb_contact_point *points = (sb_contact_point *)calloc((size_t)count + 1, sizeof *points);
    unsigned long long hash = (unsigned long long)count;
    sb_contact_points(s->contact, points, count);
    *organs = 0;
    for (int i = 0; i < count; i++) {
        int names[5];
        names[0] = points[i].tool, names[1] = points[i].element, names[2] = points[i].face;
        names[3] = points[i].other_element, names[4] = points[i].other_face;
        hash = 31 * (31 * hash + scene_hash(names, sizeof names)) + scene_hash(&points[i].force, sizeof(sb_vec3));
        *organs += points[i].tool < 0;
    }
    free(points);
    return hash;
}

/* Steps that are taken back leave the skin's points in the cells that had them, and what touches with it: each step is
 * that of a scene in which none was taken back. Returns in how many of these the mesh had changed while organs touched.
 */
static int compare_taken_back(scene *trying, scene *plain, int seed)
{
    struct ndli_site *site = trying->needles.needles[0]->site;
    int changed = 0, organs = 0, others, same = 1;
    for (int i = 0; i < 20 && same; i++) {
        uint64_t hash = sb_body_state_hash(trying->needles.body);
        int version = sb_body_mesh_version(trying->needles.body), tries = i % 5 == 4 ? 3 : 0;
        CHECK(!tries || ndli_needle_keep(site, NDLI_KEPT_SUBSTEP));
        for (int t = 0; t < tries; t++)
            skinned_step(trying, seed, i + 1 + t);
        changed += sb_body_mesh_version(trying->needles.body) > version && (!trying->needles.beside || organs > 0);
        CHECK_OK(tries ? ndli_needle_undo(site, NDLI_KEPT_SUBSTEP, NULL) : SB_OK);
        CHECK(sb_body_state_hash(trying->needles.body) == hash);
        same = points_of(trying, &others) == points_of(plain, &organs) && others == organs;
        same &= skinned_step(trying, seed, i) == skinned_step(plain, seed, i);
        same &= bits(trying) == bits(plain) && has_same_skin(trying, plain);
        same &= points_of(trying, &others) == points_of(plain, &organs);
        if (!CHECK(same))
            printf("    scene %d, step %d\n", seed, i);
    }
    return changed;
}

static void test_skin_taken_back(void)
{
    int changed = 0, crowded = 0;
    for (int k = 0; k < check_rounds(4); k++) {
        sb_mesh cubes = make_two_cubes();
        scene trying, plain;
        unsigned long long seed = 60 + (unsigned long long)k;
        if (!make_crowd(&trying, NDL_REMESH, seed, NULL, k % 2 ? &cubes : NULL) ||
            !make_crowd(&plain, NDL_REMESH, seed, NULL, k % 2 ? &cubes : NULL))
            return;
        *(k % 2 ? &crowded : &changed) += compare_taken_back(&trying, &plain, k);
        free_scene(&trying);
        free_scene(&plain);
        sb_mesh_free(&cubes);
    }
    printf("taken back: the mesh had changed %d times, %d times while organs touched\n", changed, crowded);
    CHECK(changed > 0 && (check_rounds(4) < 2 || crowded > 0));
}

/* Each allocation of a load fails in turn: it changes nothing, and what follows the one that succeeds is the same. */
static void test_skin_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    scene a, b;
    sb_result result = SB_ERROR_MEMORY;
    size_t size;
    void *image;
    uint64_t before;
    if (!make_skinned(&a, NDL_REMESH, 42, NULL) || !make_skinned(&b, NDL_REMESH, 42, &memory))
        return;
    for (int i = 0; i < 10; i++)
        skinned_step(&a, 2, i);
    size = sb_body_state_size(a.needles.body);
    image = malloc(size);
    CHECK_OK(sb_body_state_save(a.needles.body, image, size));
    before = sb_body_state_hash(b.needles.body);
    for (int n = 1; n < 4000 && result != SB_OK; n += 1 + n / 8) {
        memory.calls = 0;
        memory.fail_at = n;
        result = sb_body_state_load(b.needles.body, image, size, NULL);
        CHECK(result == SB_OK || (result == SB_ERROR_MEMORY && sb_body_state_hash(b.needles.body) == before));
    }
    memory.fail_at = 0;
    CHECK(result == SB_OK && sb_body_state_hash(a.needles.body) == sb_body_state_hash(b.needles.body));
    CHECK(skinned_step(&a, 2, 10) == skinned_step(&b, 2, 10) && bits(&a) == bits(&b) && has_same_skin(&a, &b));
    free(image);
    free_scene(&a);
    free_scene(&b);
    CHECK_INT(memory.live, 0);
}

/* What is saved of a skin, damaged: refused, or as good as before. */
static void test_skin_forged(void)
{
    unsigned long long seed = 9;
    int refused = 0;
    scene s;
    sb_skin *skin;
    sbi_state_out out;
    unsigned char *bytes;
    if (!make_skinned(&s, NDL_REMESH, 40, NULL))
        return;
    for (int i = 0; i < 10; i++)
        skinned_step(&s, 1, i);
    skin = s.skin;
    memset(&out, 0, sizeof out);
    skin->save(skin, &out);
    bytes = out.bytes = (unsigned char *)malloc(out.used);
    for (int k = 0; k < check_rounds(200); k++) {
        out.used = 0;
        skin->save(skin, &out);
        for (int n = 0; n < 1 + k % 3; n++)
            bytes[(size_t)(check_random(&seed) * (double)out.used)] ^=
                (unsigned char)(1 + (int)(check_random(&seed) * 254));
        if (skin->check(skin, s.needles.body, sbi_part_read(bytes, out.used - (size_t)(k % 50 == 9)), NULL) != SB_OK) {
            refused++;
        } else if (k % 2) {
            s.contact->faces_old |= skin->load(skin);
            CHECK_OK(skinned_step(&s, 1, 10 + k % 7));
        } else {
            skin->give_up(skin);
        }
    }
    CHECK(refused > 5);
    free(bytes);
    free_scene(&s);
}

/* ---- steps that are taken back ---- */

/* Steps that are taken back leave nothing, whether the mesh has followed the tip in them or not: state, readings, and
 * what comes after. */
static void check_taken_back(scene *trying, scene *plain, int number, int steps)
{
    struct ndli_site *site = trying->needles.needles[0]->site;
    sb_contact_info info = sb_contact_get_info(trying->contact), after;
    unsigned long long before = bits(trying);
    uint64_t hash;
    send_ball(trying, number, 0);
    hash = sb_body_state_hash(trying->needles.body);
    CHECK(ndli_needle_keep(site, NDLI_KEPT_SUBSTEP)); /* steps without membranes make no use of it */
    for (int i = 0; i < steps; i++)
        CHECK_OK(divided_step(trying, number + 1 + i, 0));
    CHECK_OK(ndli_needle_undo(site, NDLI_KEPT_SUBSTEP, NULL));
    ndli_rod_publish(trying->needles.needles[0]->rod);
    after = sb_contact_get_info(trying->contact);
    CHECK(sb_body_state_hash(trying->needles.body) == hash);
    CHECK(bits(trying) == before);
    CHECK(memcmp(&after, &info, sizeof after) == 0);
    CHECK_OK(divided_step(trying, number, 0));
    CHECK_OK(divided_step(plain, number, 0));
    CHECK(bits(trying) == bits(plain));
}

static void test_taken_back(void)
{
    int changed = 0;
    for (int k = 0; k < check_rounds(8); k++) {
        scene trying, plain;
        ndl_follow follow = k % 2 ? NDL_REMESH : NDL_EMBED;
        int skinned = k % 4 > 1;
        if (!make_divided(&trying, follow, 0, skinned, 120 + (unsigned)k, NULL) ||
            !make_divided(&plain, follow, 0, skinned, 120 + (unsigned)k, NULL))
            return;
        for (int i = 0; i < 26; i++) {
            int version = sb_body_mesh_version(trying.needles.body);
            check_taken_back(&trying, &plain, i, 1 + i % 3);
            changed += sb_body_mesh_version(trying.needles.body) > version + 1;
        }
        CHECK(sb_v3_norm(wrench_of(&plain)) > 0);
        free_scene(&trying);
        free_scene(&plain);
    }
    CHECK(changed > 0);
}

/* ---- cuts ---- */

/* Needles cannot follow pieces of elements: said by name, and the body can be stepped without them. */
static void test_cut(void)
{
    scene s;
    sb_cut_def def = sb_default_cut_def();
    sb_cut *cut = NULL;
    sb_vec3 plane[3];
    uint64_t before;
    int cells;
    if (!make_scene(&s, 3))
        return;
    def.body = s.needles.body;
    cells = sb_body_element_count(def.body);
    plane[0] = placed(&s, 0.0153, -1, -1), plane[1] = placed(&s, 0.0153, 1, -1), plane[2] = placed(&s, 0.0153, 0, 2);
    CHECK_OK(sb_cut_create(&def, &cut, NULL));
    CHECK_OK(sb_cut_triangles(cut, plane, 1, NULL, NULL));
    CHECK(sb_body_element_count(def.body) > cells);
    before = sb_body_state_hash(def.body);
    CHECK_RESULT(ndl_step(def.body, s.needles.needles, 1, REAL(0.02), NULL, NULL, &s.needles.error),
                 SB_ERROR_UNSUPPORTED);
    CHECK(strstr(s.needles.error.message, "cut") && sb_body_state_hash(def.body) == before);
    CHECK_OK(sb_body_step(def.body, REAL(0.02), NULL));
    sb_cut_destroy(cut);
    free_scene(&s);
}

CHECK_SUITE(contact_needle, {"random", test_random}, {"balance", test_balance}, {"threads", test_threads},
            {"states", test_states}, {"recordings", test_recordings}, {"divided", test_divided},
            {"divided, nearer", test_nearer}, {"apart", test_apart}, {"no memory", test_no_memory_taken},
            {"memory", test_memory}, {"supports", test_supports}, {"skin states", test_skin_states},
            {"skin taken back", test_skin_taken_back}, {"skin memory", test_skin_memory},
            {"skin forged", test_skin_forged}, {"taken back", test_taken_back}, {"cut", test_cut});
