/* Needles and tools on one organ: forces balance, nothing that one does is lost on the other, and states, recordings
 * and steps taken back hold both. Generated scenes. */
#include "contact_scene.h"
#include "needle_scene.h"

/* A needle scene whose body a ball touches as well. */
typedef struct scene {
    needle_scene needles;
    sb_contact *contact;
    int ball;
    double radius;
    int workers;
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
    *n = needle_scene_default();
    s->contact = NULL;
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

/* At rest supports, sleeve and ball hold the organ together. */
static void test_balance(void)
{
    for (int seed = 0; seed < 6; seed++) {
        scene s;
        sb_vec3 sum = sb_v3(0, 0, 0), sleeve;
        sb_pose pose;
        ndl_command none = needle_command(0, 0);
        double most;
        if (!make_scene(&s, seed))
            return;
        random_steps(&s, seed, 0, 12);
        pose.position = placed(&s, 0.018, 0.02, 0.0385 + s.radius);
        pose.rotation = sb_quat_identity();
        for (int i = 0; i < 150; i++) {
            CHECK_OK(sb_contact_move_tool(s.contact, s.ball, &pose));
            CHECK_OK(ndl_step(s.needles.body, s.needles.needles, 1, REAL(0.05), &none, NULL, NULL));
        }
        ndl_needle_base_wrench(s.needles.needles[0], &sleeve, NULL);
        for (int i = 0; i < sb_body_node_count(s.needles.body); i++)
            sum = sb_v3_add(sum, sb_body_reactions(s.needles.body)[i]);
        most = fmax((double)sb_v3_norm(sum), (double)sb_v3_norm(wrench_of(&s)));
        CHECK((double)sb_v3_norm(wrench_of(&s)) > 0.01 && (double)sb_v3_norm(sleeve) > 0.01);
        sum = sb_v3_sub(sb_v3_add(sum, sleeve), wrench_of(&s));
        if (!CHECK((double)sb_v3_norm(sum) < 1e-3 * most))
            printf("  seed %d: %g of %g N\n", seed, (double)sb_v3_norm(sum), most);
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
            {"states", test_states}, {"recordings", test_recordings}, {"cut", test_cut});
